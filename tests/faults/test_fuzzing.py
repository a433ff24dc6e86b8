"""Every decoder against hostile bodies, each in a process of its own: no crash, no hang, little memory.

Small bodies in their thousands for what lies deep in a format, and bodies near the limits of production for memory and
time.  Seconds in CI; ``make test-faults`` sets SCATOLA_FUZZ_SECONDS to ten minutes for each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.faults.fuzzing import READERS

SECONDS = float(os.environ.get("SCATOLA_FUZZ_SECONDS", "3"))
SEED = os.environ.get("SCATOLA_FUZZ_SEED", "1")
MOST_MB = 300.0
SLOWEST_S = 5.0
BUSY_S = 240.0
"""Each large shape takes its time, also where the seconds are few."""

pytestmark = pytest.mark.timeout(SECONDS + BUSY_S + 60)


def survived(size: str, reader: str) -> dict[str, float]:
    """Fuzz a reader with bodies of a size; what was found."""
    command = [sys.executable, "-m", "tests.faults.fuzzing", size, reader, str(SECONDS), SEED]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS + BUSY_S, check=False)
    assert ended.returncode == 0, ended.stderr[-4000:]
    found = json.loads(ended.stdout)
    print(size, reader, found)
    assert found["slowest_s"] < SLOWEST_S
    assert found["peak_mb"] < MOST_MB
    assert found["read"] > 0
    return found


@pytest.mark.parametrize("reader", READERS)
def test_a_decoder_survives(reader):
    assert survived("small", reader)["tried"] > 100


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_a_decoder_survives_bodies_near_the_limits(reader):
    survived("large", reader)
