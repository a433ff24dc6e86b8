"""Content-Encoding: unpacking that stops at a limit, so that a small body cannot become a large one."""

from __future__ import annotations

import io
import zlib

import zstandard

from server.errors import InvalidError, TooLargeError, UnsupportedMediaError

_CHUNK = 1 << 18
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


def _gunzip(body: bytes, max_bytes: int) -> bytes:
    out = bytearray()
    rest = body
    while True:  # a gzip file may have several members
        member = zlib.decompressobj(_GZIP_WINDOW)
        while not member.eof:
            try:
                chunk = member.decompress(rest, _CHUNK)
            except zlib.error as error:
                raise InvalidError(f"Not readable gzip: {error}", code="gzip") from None
            rest = member.unconsumed_tail
            out += chunk
            if len(out) > max_bytes:
                raise _too_large(max_bytes)
            if not chunk and not rest and not member.eof:
                raise InvalidError("The gzip body is cut off", code="gzip")
        rest = member.unused_data
        if not rest:
            return bytes(out)


def _unzstd(body: bytes, max_bytes: int) -> bytes:
    unpacker = zstandard.ZstdDecompressor(max_window_size=_MAX_ZSTD_WINDOW)
    try:
        # Measured in bounded steps first: the second pass, which alone can tell that a frame is cut
        # off, hands out whole frames at once.
        total = 0
        with unpacker.stream_reader(io.BytesIO(body), read_across_frames=True) as reader:
            while step := len(reader.read(_CHUNK)):
                total += step
                if total > max_bytes:
                    raise _too_large(max_bytes)
        out = bytearray()
        rest = body
        while rest:
            frame = unpacker.decompressobj()
            out += frame.decompress(rest)
            if not frame.eof:
                raise InvalidError("The zstd body is cut off", code="zstd")
            rest = frame.unused_data
    except zstandard.ZstdError as error:
        raise InvalidError(f"Not readable zstd: {error}", code="zstd") from None
    return bytes(out)
