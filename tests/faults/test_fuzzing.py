"""Every decoder against mutated bodies, each in a process of its own: no crash, no hang, little memory.

Seconds in CI; ``make test-faults`` sets SCATOLA_FUZZ_SECONDS to ten minutes for each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from server.formats.decode import MEDIA_TYPES
from tests.faults.fuzzing import SLOWEST_S

SECONDS = float(os.environ.get("SCATOLA_FUZZ_SECONDS", "3"))
MOST_MB = 300.0


@pytest.mark.timeout(SECONDS + 120)
@pytest.mark.parametrize("media_type", MEDIA_TYPES)
def test_a_decoder_survives(media_type):
    seed = os.environ.get("SCATOLA_FUZZ_SEED", "1")
    command = [sys.executable, "-m", "tests.faults.fuzzing", media_type, str(SECONDS), seed]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS + 60, check=False)
    assert ended.returncode == 0, ended.stderr[-4000:]
    found = json.loads(ended.stdout)
    print(media_type, found)
    assert found["tried"] > 100
    assert found["read"] > 0
    assert found["slowest_s"] < SLOWEST_S
    assert found["peak_mb"] < MOST_MB
