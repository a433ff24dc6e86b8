"""Fuzz one decoder in this process for so long: ``python -m tests.faults.fuzzing MEDIA_TYPE SECONDS SEED``.

Bodies are mutations of valid ones, checksums put right again half of the time, so that what lies behind them is
reached.  Bodies that were read, or refused for a new reason, become seeds themselves.  A crash ends the process,
a hang is seen by whoever started it, any other error is raised; at the end, one line of JSON.
"""

from __future__ import annotations

import json
import random
import re
import resource
import struct
import sys
import time
import zlib
from pathlib import Path

from server.errors import InvalidError, TooLargeError
from server.formats.codec8e import _crc16
from server.formats.decode import decode
from server.formats.encoding import unpack
from tests.faults.seeds import seeds

MAX_DECODED_BYTES = 16 * 1024 * 1024
MAX_BODY_BYTES = 256 * 1024
SLOWEST_S = 5.0
_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_WORDS = (b"nan", b"1e999", b"-1", b"null", b"[" * 1000, b'{"columns":' * 200, b",", b"\n", b"\0", b"9" * 400, b'"')


def _peak_mb() -> float:
    """Of this process image alone; getrusage's figure is inherited from whoever started it."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def mutated(body: bytes, rng: random.Random, others: list[bytes]) -> bytes:
    """The body with a few things wrong."""
    out = bytearray(body)
    for _ in range(1 << rng.randrange(5)):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(7):
            case 0 if at < len(out):
                out[at] ^= 1 << rng.randrange(8)
            case 1 if at < len(out):
                out[at] = rng.randrange(256)
            case 2:
                size = rng.choice((1, 2, 4, 8))
                value = (rng.choice(_INTERESTING) & (2 ** (8 * size) - 1)).to_bytes(size, rng.choice(("little", "big")))
                out[at : at + size] = value
            case 3:
                del out[at : at + rng.randrange(1, 64)]
            case 4:
                out[at:at] = out[at : at + rng.randrange(1, 256)] * rng.randrange(1, 8)
            case 5:
                out[at:at] = rng.choice(_WORDS)
            case _:
                other = rng.choice(others)
                begin = rng.randrange(len(other) + 1)
                out[at:] = other[begin:]
    return bytes(out[:MAX_BODY_BYTES])


def sealed(media_type: str, body: bytes) -> bytes:
    """The body with its checksum and lengths put right, where its format has any in one place."""
    if media_type == "application/vnd.scatola.batch" and len(body) > 20:
        body = body[:8] + struct.pack("<I", len(body)) + body[12:-4]
        return body + struct.pack("<I", zlib.crc32(body))
    if media_type == "application/vnd.scatola.codec8e" and len(body) > 16:
        data = body[8:-4]
        return body[:4] + struct.pack(">I", len(data)) + data + struct.pack(">I", _crc16(memoryview(data)))
    return body


def fuzz(media_type: str, seconds: float, seed: int) -> dict[str, float]:
    """Mutate and decode; what was tried and how long the slowest took."""
    rng = random.Random(seed)
    corpus = [seeds()[media_type]]
    reasons: set[str] = set()
    tried = read = 0
    slowest_s = 0.0
    end = time.monotonic() + seconds
    # A busy machine gets through few bodies in a few seconds: longer, until one of them could be read.
    while (now := time.monotonic()) < end or (read == 0 and now < end + 10.0 * seconds):
        body = mutated(rng.choice(corpus), rng, corpus)
        if rng.random() < 0.5:
            body = sealed(media_type, body)
        began = time.perf_counter()
        try:
            if rng.random() < 0.05:
                body = unpack(body, rng.choice(("gzip", "zstd")), max_bytes=MAX_DECODED_BYTES)
            columns = decode(media_type, body, max_decoded_bytes=MAX_DECODED_BYTES)
            columns.column_sha256()
            read += 1
            reason = f"read {columns.rows.bit_length()} {len(columns.values)}"
        except (InvalidError, TooLargeError) as error:
            reason = re.sub(r"[0-9]+|'.*?'", "", error.detail)[:60]
        except BaseException:
            print(f"body: {body.hex()}", file=sys.stderr)
            raise
        slowest_s = max(slowest_s, time.perf_counter() - began)
        tried += 1
        if reason not in reasons and len(corpus) < 500:
            reasons.add(reason)
            corpus.append(body)
    peak_mb = _peak_mb()
    return {"tried": tried, "read": read, "reasons": len(reasons), "slowest_s": slowest_s, "peak_mb": peak_mb}


if __name__ == "__main__":
    print(json.dumps(fuzz(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]))))
