"""Limits on what callers may ask of this process."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from fastapi import Request
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import InvalidError, TooLargeError
from server.problems import problem_response

_MANY_KEYS = 10_000
NUL = "Text must not hold a NUL character"


@dataclass(slots=True)
class _Bucket:
    tokens: float
    at: float


class TokenBuckets:
    """So many requests a minute per key, saved up to one minute's worth; safe among threads."""

    def __init__(self, per_minute: int) -> None:
        self._capacity = float(per_minute)
        self._per_second = per_minute / 60.0
        self._buckets: dict[str, _Bucket] = {}
        self._lock = threading.Lock()

    def take(self, key: str, now: float) -> float:
        """Take one request at `now` (s); 0 when granted, else how long to wait (s)."""
        with self._lock:
            bucket = self._buckets.get(key)
            if bucket is None:
                if len(self._buckets) >= _MANY_KEYS:
                    self._forget_full(now)
                bucket = self._buckets[key] = _Bucket(self._capacity, now)
            self._fill(bucket, now)
            if bucket.tokens >= 1.0:
                bucket.tokens -= 1.0
                return 0.0
            return (1.0 - bucket.tokens) / self._per_second

    def _fill(self, bucket: _Bucket, now: float) -> None:
        # A clock that was set back grants nothing and takes nothing away.
        bucket.tokens = min(self._capacity, bucket.tokens + max(0.0, now - bucket.at) * self._per_second)
        bucket.at = now

    def _forget_full(self, now: float) -> None:
        for key, bucket in list(self._buckets.items()):
            self._fill(bucket, now)
            if bucket.tokens >= self._capacity:
                del self._buckets[key]


class BodyLimit:
    """Ordinary bodies stay small; routes in `except_paths` have limits of their own, those in `larger` another."""

    def __init__(
        self, app: ASGIApp, *, max_bytes: int, except_paths: frozenset[str], larger: Mapping[str, int] | None = None
    ) -> None:
        self._app = app
        self._max_bytes = max_bytes
        self._except_paths = except_paths
        self._larger = larger or {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in self._except_paths:
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        max_bytes = self._larger.get(scope["path"], self._max_bytes)
        announced = request.headers.get("content-length", "")
        if announced.isdecimal() and int(announced) > max_bytes:
            error = TooLargeError(f"Body is larger than {max_bytes} bytes")
            await problem_response(error, request)(scope, receive, send)
            return
        seen = 0

        async def counted() -> Message:
            nonlocal seen
            message = await receive()
            seen += len(message.get("body", b""))
            if seen > max_bytes:
                raise HTTPException(413, f"Body is larger than {max_bytes} bytes")
            return message

        await self._app(scope, counted, send)


class NoNul:
    """Refuses text with a NUL character in path, query, JSON or form: PostgreSQL's holds none, so SQLite's shall not.

    What a box uploads is no text to be stored, and is left alone.
    """

    _ESCAPED: ClassVar[dict[str, bytes]] = {
        "application/json": rb"\u0000",
        "application/x-www-form-urlencoded": b"%00",
    }

    def __init__(self, app: ASGIApp, *, except_paths: frozenset[str]) -> None:
        self._app = app
        self._except_paths = except_paths

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in self._except_paths:
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        if "\0" in scope["path"] or b"%00" in scope["query_string"]:
            await problem_response(InvalidError(NUL), request)(scope, receive, send)
            return
        escaped = self._ESCAPED.get(request.headers.get("content-type", "").partition(";")[0].strip().lower())
        await self._app(scope, receive if escaped is None else _without(receive, escaped), send)


def _without(receive: Receive, word: bytes) -> Receive:
    """The same body, refused where it holds a word, also across two of its pieces."""
    tail = b""

    async def looked_at() -> Message:
        nonlocal tail
        message = await receive()
        piece = tail + message.get("body", b"")
        if word in piece:
            raise HTTPException(422, NUL)
        tail = piece[1 - len(word) :]
        return message

    return looked_at
