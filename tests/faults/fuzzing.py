"""Fuzz one decoder in this process for so long: ``python -m tests.faults.fuzzing small|large READER SECONDS SEED``.

Small: mutations of valid bodies, checksums put right again half of the time, so that what lies behind them is reached;
bodies that were read, or refused for a new reason, become seeds themselves.  Large: bodies near the limits of
production (`tests.faults.large`), from the packed body to the stored form as an upload goes, each measured by itself.
A crash ends the process, a hang is seen by whoever started it, any other error is raised; at the end, one line of JSON.
"""

from __future__ import annotations

import json
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator
from pathlib import Path

from server.errors import InvalidError, TooLargeError
from server.formats import decode, phone_csv
from server.formats.columns import Columns, check_size, check_values
from server.formats.encoding import unpack
from server.memory import share_heaps
from tests.faults.large import HEAD, PHONE, SHAPES, most
from tests.faults.mutations import mutated, sealed
from tests.faults.seeds import seeds

READERS = (*decode.MEDIA_TYPES, PHONE)
MAX_DECODED_BYTES = 16 * 1024 * 1024
MAX_BODY_BYTES = 256 * 1024
READ = "read"
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")

Figures = dict[str, object]


def peak_mb() -> float:
    """Of this process image alone, since `forget_peak`."""
    found = re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text(encoding="ascii"))
    assert found is not None
    return int(found[1]) / 1024.0


def forget_peak() -> None:
    """Let the peak begin anew at what is used now."""
    _CLEAR.write_text("5", encoding="ascii")


def read(reader: str, body: bytes, max_decoded_bytes: int) -> Columns:
    """Checked columns of a body."""
    if reader != PHONE:
        return decode.decode(reader, body, max_decoded_bytes=max_decoded_bytes)
    columns = phone_csv.read(body, max_decoded_bytes=max_decoded_bytes)
    check_size(columns.rows, len(columns.values), max_decoded_bytes)
    check_values(columns)
    return columns


def _reason(error: InvalidError | TooLargeError) -> str:
    return re.sub(r"[0-9]+|'.*?'", "", error.detail)[:60]


def fuzz_small(reader: str, seconds: float, seed: int) -> Figures:
    """Mutate and decode; what was tried and how long the slowest took."""
    rng = random.Random(seed)
    corpus = [seeds()[reader]]
    reasons: set[str] = set()
    tried = count = 0
    slowest_s = 0.0
    end = time.monotonic() + seconds
    # A busy machine gets through few bodies in a few seconds: longer, until one of them could be read.
    while (now := time.monotonic()) < end or (count == 0 and now < end + 10.0 * seconds):
        body = mutated(rng.choice(corpus), rng, corpus, most=MAX_BODY_BYTES)
        if rng.random() < 0.5:
            body = sealed(reader, body)
        began = time.perf_counter()
        try:
            if rng.random() < 0.05:
                body = unpack(body, rng.choice(("gzip", "zstd")), max_bytes=MAX_DECODED_BYTES)
            columns = read(reader, body, MAX_DECODED_BYTES)
            columns.column_sha256()
            count += 1
            reason = f"read {columns.rows.bit_length()} {len(columns.values)}"
        except (InvalidError, TooLargeError) as error:
            reason = _reason(error)
        except BaseException:
            print(f"body: {body.hex()}", file=sys.stderr)
            raise
        slowest_s = max(slowest_s, time.perf_counter() - began)
        tried += 1
        if reason not in reasons and len(corpus) < 500:
            reasons.add(reason)
            corpus.append(body)
    return {"tried": tried, "read": count, "reasons": len(reasons), "slowest_s": slowest_s, "peak_mb": peak_mb()}


def _made(reader: str, seed: int, until: Callable[[], bool]) -> Generator[tuple[str, str, bytes]]:
    """Bodies from the process that makes them: shape, encoding, what is sent."""
    command = [sys.executable, "-m", "tests.faults.large", reader, str(seed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as maker:
        assert maker.stdout is not None
        try:
            while not until():
                told, size = HEAD.unpack(maker.stdout.read(HEAD.size))
                name, encoding = json.loads(maker.stdout.read(told))
                # Nothing here holds on to it: it would be there beside the next one.
                yield name, encoding, maker.stdout.read(size)
        finally:
            maker.kill()


def _upload(reader: str, encoding: str, sent: bytes) -> str:
    """From what was sent to the stored form, as an upload goes; how it ended."""
    limit = most(reader)
    try:
        columns = read(reader, unpack(sent, encoding, max_bytes=limit), limit)
        columns.column_sha256()
        columns.to_parquet()
    except (InvalidError, TooLargeError) as error:
        return _reason(error)
    return READ


def fuzz_large(reader: str, seconds: float, seed: int) -> Figures:
    """Each shape whole, then all of them at random for so long; the largest and the slowest.

    Time is the processor's: on a busy machine, the clock would tell of the others.
    """
    share_heaps()
    decode.load()
    ended: Counter[str] = Counter()
    peaks: dict[str, float] = {}
    slowest: dict[str, float] = {}
    began = time.monotonic()
    for name, encoding, sent in _made(
        reader, seed, lambda: ended.total() >= len(SHAPES[reader]) and time.monotonic() - began >= seconds
    ):
        forget_peak()
        start = time.process_time()
        try:
            ended[_upload(reader, encoding, sent)] += 1
        except BaseException:
            kept = Path(tempfile.mkdtemp(prefix="scatola-fuzz-")) / "body"
            kept.write_bytes(sent)
            print(f"shape {name!r}, {encoding or 'not packed'}, kept in {kept}", file=sys.stderr)
            raise
        slowest[name] = max(slowest.get(name, 0.0), time.process_time() - start)
        peaks[name] = max(peaks.get(name, 0.0), peak_mb())
        del sent
    by_time = sorted(slowest, key=lambda name: -slowest[name])
    by_peak = sorted(peaks, key=lambda name: -peaks[name])
    return {
        "tried": ended.total(),
        "read": ended[READ],
        "reasons": len(ended),
        "slowest_s": slowest[by_time[0]],
        "peak_mb": peaks[by_peak[0]],
        "slowest": {name: round(slowest[name], 2) for name in by_time[:3]},
        "largest": {name: round(peaks[name]) for name in by_peak[:3]},
    }


if __name__ == "__main__":
    work = fuzz_small if sys.argv[1] == "small" else fuzz_large
    print(json.dumps(work(sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))))
