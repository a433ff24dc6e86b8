"""Security headers on every answer; a header that a route set itself is left alone."""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.settings import Settings


def tile_source(url: str | None) -> str:
    """CSP source of the operator's map tiles, e.g. ``https://tiles.example``; empty when there are none."""
    parts = urlsplit(url or "")
    if parts.scheme not in ("http", "https") or not parts.netloc:
        return ""
    # A template such as {s}.tiles.example stands for several hosts, which CSP can only say with a star.
    host = "*." + parts.netloc.split("}.", 1)[1] if parts.netloc.startswith("{") else parts.netloc
    return f"{parts.scheme}://{host}"


def content_security_policy(settings: Settings) -> str:
    """The pages' policy: everything from here, plus the operator's tiles; MapLibre's workers may be blobs."""
    tiles = " ".join(filter(None, map(tile_source, (settings.map_tiles_url, settings.map_pmtiles))))
    sources = {
        "default-src": "'self'",
        "script-src": "'self'",
        "style-src": "'self'",
        "img-src": f"'self' data: blob: {tiles}",
        "connect-src": f"'self' {tiles}",
        "worker-src": "'self' blob:",
        "frame-src": "'self'",
        "object-src": "'none'",
        "base-uri": "'self'",
        "form-action": "'self'",
        "frame-ancestors": "'self'",
    }
    return "; ".join(f"{directive} {source}".strip() for directive, source in sources.items())


class SecurityHeaders:
    """Add the headers where they are missing."""

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        self._app = app
        self._headers = {
            "Content-Security-Policy": content_security_policy(settings),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Permissions-Policy": "geolocation=(), camera=(), microphone=()",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        static = scope["path"].startswith("/static/")

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-cache" if static else "no-store")
            await send(message)

        await self._app(scope, receive, with_headers)
