"""A few things wrong in a body, and its checksums put right again."""

from __future__ import annotations

import random
import struct
import zlib

from server.formats.codec8e import _crc16

_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_WORDS = (
    *(b"nan", b"1e999", b"-1", b"null", b"[" * 1000, b'{"columns":' * 200, b",", b"\n", b"\0", b"9" * 400, b'"'),
    *(b"\r", b"\r\n", b"\r\r\n", b"\n\r", b"\r" * 1000, b"\r\n" * 500, b"\x0b\x0c\x1c\x1d\x1e\x85", b","),
)


def mutated(body: bytes, rng: random.Random, others: list[bytes], *, most: int) -> bytes:
    """The body with a few things wrong, at most so long."""
    out = bytearray(body)
    for _ in range(1 << rng.randrange(5)):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(8):
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
            case 6:
                # Line ends as other systems write them, in all of the body or in a piece.
                end = len(out) if rng.random() < 0.5 else at + rng.randrange(1, 65536)
                old, new = rng.sample((b"\n", b"\r\n", b"\r", b""), 2)
                out[at:end] = out[at:end].replace(old or b"\n", new)
            case _:
                other = rng.choice(others)
                begin = rng.randrange(len(other) + 1)
                out[at : at + len(other) - begin] = other[begin:]
    return bytes(out[:most])


def sealed(media_type: str, body: bytes) -> bytes:
    """The body with its checksum and lengths put right, where its format has any in one place."""
    if media_type == "application/vnd.scatola.batch" and len(body) > 20:
        body = body[:8] + struct.pack("<I", len(body)) + body[12:-4]
        return body + struct.pack("<I", zlib.crc32(body))
    if media_type == "application/vnd.scatola.codec8e" and 16 < len(body) < 1 << 22:
        data = body[8:-4]
        return body[:4] + struct.pack(">I", len(data)) + data + struct.pack(">I", _crc16(memoryview(data)))
    return body
