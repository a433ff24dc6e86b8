"""Bodies near the limits of production: ``python -m tests.faults.large READER SEED`` writes one after the other.

Each is the lengths of two parts, the name of its shape and its encoding as JSON, and what is sent.  They are made in a
process of their own: the memory of the one that reads them is then nobody else's.  Half have a few things wrong.
"""

from __future__ import annotations

import gzip
import json
import random
import struct
import sys
from collections.abc import Callable, Generator
from typing import BinaryIO

import zstandard

from server.settings import Settings
from tests.faults import large_binary, large_text
from tests.faults.mutations import mutated, sealed

MAX_BODY_BYTES = int(Settings.model_fields["max_body_bytes"].default)
MAX_DECODED_BYTES = int(Settings.model_fields["max_decoded_bytes"].default)
PHONE = "phone"
"""The reader of loggers' CSV, which no media type names: files for the workbench reach it."""
HEAD = struct.Struct("<II")

Shape = Callable[[int], bytes]
SHAPES: dict[str, dict[str, Shape]] = {**large_text.SHAPES, **large_binary.SHAPES}


def most(reader: str) -> int:
    """What a reader may decode; less for the one that only processes of their own have, which may use more memory."""
    return MAX_DECODED_BYTES // 4 if reader == PHONE else MAX_DECODED_BYTES


def _zstd(body: bytes, level: int) -> bytes:
    return zstandard.ZstdCompressor(level=level).compress(body)


def packed(body: bytes, rng: random.Random) -> tuple[str, bytes]:
    """As it is where it fits, else packed; what does not fit then either loses its end."""
    kind = rng.choice(("", "gzip", "zstd", "zstd"))
    if kind == "" and len(body) <= MAX_BODY_BYTES:
        return "", body
    level = rng.choice((1, 3)) if len(body) > 1 << 20 else rng.choice((1, 3, 9))
    while True:
        sent = gzip.compress(body, level) if kind == "gzip" else _zstd(body, level)
        if len(sent) <= MAX_BODY_BYTES:
            return kind or "zstd", sent
        body = body[: int(len(body) * MAX_BODY_BYTES / len(sent) * 0.95)]


def _bomb(rng: random.Random, limit: int) -> tuple[str, str, bytes]:
    """What is hostile in its packing, whatever it holds."""
    name = rng.choice(("members", "frames", "skippable", "just under", "just over", "twice"))
    if name == "members":
        return name, "gzip", gzip.compress(rng.choice((b"", b"1")), 1) * (MAX_BODY_BYTES // 24)
    if name == "frames":
        return name, "zstd", _zstd(rng.choice((b"", b"1")), 1) * (MAX_BODY_BYTES // 16)
    if name == "skippable":
        return name, "zstd", struct.pack("<II", 0x184D2A50, 0) * (MAX_BODY_BYTES // 8 - 8) + _zstd(b"1", 1)
    piece = rng.choice((b"\0", b" ", b"[", b"\r", b"$GPGGA,\r", b"1,"))
    size = limit - 1 if name == "just under" else limit + 1
    body = (piece * (size // len(piece) + 1))[:size]
    if name == "twice":
        return name, "zstd", _zstd(_zstd(bytes(16 * limit), 1), 1)
    return (name, "gzip", gzip.compress(body, 1)) if rng.random() < 0.5 else (name, "zstd", _zstd(body, 1))


def bodies(reader: str, seed: int) -> Generator[tuple[str, str, bytes]]:
    """Shape, content encoding, and what is sent; without end, each shape whole before any is mutated."""
    rng = random.Random(seed)
    shapes, limit = SHAPES[reader], most(reader)
    for name, shape in shapes.items():
        yield name, *packed(shape(limit), rng)
    while True:
        if rng.random() < 0.1:
            name, encoding, sent = _bomb(rng, limit)
            yield f"bomb: {name}", encoding, sent
            continue
        name = rng.choice(list(shapes))
        # Its own largest, or less: what a limit refuses as a whole hides what lies behind.
        body = shapes[name](int(limit * rng.choice((0.01, 0.1, 0.25, 0.5, 1.0))))
        if rng.random() < 0.6:
            body = mutated(body, rng, [body[:65536]], most=limit)
            body = sealed(reader, body)
        yield name, *packed(body, rng)


def write(reader: str, seed: int, out: BinaryIO) -> None:
    """Write bodies until nobody reads them."""
    for name, encoding, sent in bodies(reader, seed):
        head = json.dumps([name, encoding]).encode()
        try:
            out.write(HEAD.pack(len(head), len(sent)) + head)
            out.write(sent)
            out.flush()
        except BrokenPipeError:
            return


if __name__ == "__main__":
    write(sys.argv[1], int(sys.argv[2]), sys.stdout.buffer)
