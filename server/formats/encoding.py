"""Content-Encoding: unpacking that stops at a limit, so that a small body cannot become a large one."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator

import zstandard

from server.errors import InvalidError, TooLargeError, UnsupportedMediaError

_CHUNK = 1 << 18
_PIECE = 1 << 16
_MAX_MEMBERS = 10_000
"""Files of several members have blocks of 64 KiB; one that has more is made of nothing but heads."""
_GZIP_WINDOW = 31
# RFC 9659: the largest window that content encoding may ask for.
_MAX_ZSTD_WINDOW = 8 * 1024 * 1024
_ENCODINGS = {"": "", "identity": "", "gzip": "gzip", "x-gzip": "gzip", "zstd": "zstd"}


def encoding_of(header: str) -> str:
    """``gzip``, ``zstd`` or nothing."""
    encoding = _ENCODINGS.get(header.strip().lower())
    if encoding is None:
        raise UnsupportedMediaError(f"Content-Encoding is gzip or zstd, not {header[:40]!r}")
    return encoding


def unpack(body: bytes, encoding: str, *, max_bytes: int) -> bytes:
    """The body without its encoding, at most `max_bytes` long."""
    if encoding == "gzip":
        return _gunzip(body, max_bytes)
    if encoding == "zstd":
        return _unzstd(body, max_bytes)
    if len(body) > max_bytes:
        raise _too_large(max_bytes)
    return body


def _too_large(max_bytes: int) -> TooLargeError:
    return TooLargeError(f"The body unpacks to more than {max_bytes} bytes")


def _pieces(body: bytes, size: int) -> Iterator[bytes]:
    """The body in pieces: what an unpacker has not used it hands back as a copy, which must not be all of the rest."""
    return (body[begin : begin + size] for begin in range(0, len(body), size))


def _gunzip(body: bytes, max_bytes: int) -> bytes:
    out, members = io.BytesIO(), 1
    member = zlib.decompressobj(_GZIP_WINDOW)
    try:
        for piece in _pieces(body, _PIECE):
            rest = piece
            while rest:
                if member.eof:  # a gzip file may have several
                    members += 1
                    _check_members(members, "gzip")
                    member = zlib.decompressobj(_GZIP_WINDOW)
                _take(out, member.decompress(rest, _CHUNK), max_bytes)
                rest = member.unused_data if member.eof else member.unconsumed_tail
        # What is unpacked already may wait within the unpacker for room.
        while not member.eof and (chunk := member.decompress(b"", _CHUNK)):
            _take(out, chunk, max_bytes)
    except zlib.error as error:
        raise InvalidError(f"Not readable gzip: {error}", code="gzip") from None
    if not member.eof:
        raise InvalidError("The gzip body is cut off", code="gzip")
    return out.getvalue()


def _take(out: io.BytesIO, chunk: bytes, max_bytes: int) -> None:
    if out.tell() + len(chunk) > max_bytes:
        raise _too_large(max_bytes)
    out.write(chunk)


def _check_members(count: int, encoding: str) -> None:
    if count > _MAX_MEMBERS:
        raise InvalidError(f"The {encoding} body has more than {_MAX_MEMBERS} parts", code=encoding)


def _unzstd(body: bytes, max_bytes: int) -> bytes:
    unpacker = zstandard.ZstdDecompressor(max_window_size=_MAX_ZSTD_WINDOW)
    try:
        # Measured in bounded steps first: the second pass, which alone can tell that a frame is cut off, hands out at
        # once whatever a piece unpacks to, up to 32 KiB for each of its bytes.
        total = 0
        with unpacker.stream_reader(io.BytesIO(body), read_across_frames=True) as reader:
            while step := len(reader.read(_CHUNK)):
                total += step
                if total > max_bytes:
                    raise _too_large(max_bytes)
        out, frames = io.BytesIO(), 1
        frame = unpacker.decompressobj()
        for piece in _pieces(body, _PIECE if total < _CHUNK * 16 else _PIECE // 256):
            rest = piece
            while rest:
                if frame.eof:
                    frames += 1
                    _check_members(frames, "zstd")
                    frame = unpacker.decompressobj()
                out.write(frame.decompress(rest))
                rest = frame.unused_data
    except zstandard.ZstdError as error:
        raise InvalidError(f"Not readable zstd: {error}", code="zstd") from None
    if body and not frame.eof:
        raise InvalidError("The zstd body is cut off", code="zstd")
    return out.getvalue()
