"""The session cookie."""

from __future__ import annotations

from starlette.requests import HTTPConnection
from starlette.responses import Response

from server.accounts.service import SESSION_LIFE

COOKIE = "scatola_session"


def cookie_header(token: str, connection: HTTPConnection) -> str:
    """Value of Set-Cookie for a session; an empty token deletes it."""
    response = Response()
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(SESSION_LIFE.total_seconds()) if token else 0,
        httponly=True,
        samesite="lax",
        secure=connection.url.scheme in ("https", "wss"),
    )
    return response.headers["set-cookie"]
