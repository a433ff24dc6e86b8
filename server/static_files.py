"""Scripts, styles and pictures of the pages.

Pages name them under an address with a hash of them all, which browsers keep without asking again; a page that
was written by another version of the server gets the files there are, and asks again the next time.
"""

from __future__ import annotations

from functools import cache
from hashlib import sha256

from fastapi import FastAPI
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from server.resources import folder

ROOTS = (("/vendor", "vendor"), ("", "static"))
"""Ends of the addresses and the folders of `web`; the first that fits is taken."""

_FOREVER = "public, max-age=31536000, immutable"


@cache
def version() -> str:
    """Changes when any of the files does."""
    found = sha256()
    for _, name in ROOTS:
        top = folder("web") / name
        for file in sorted(path for path in top.rglob("*") if path.is_file()):
            found.update(file.relative_to(top).as_posix().encode() + b"\0" + sha256(file.read_bytes()).digest())
    return found.hexdigest()[:16]


def address() -> str:
    """Where pages find the files."""
    return f"/static/v/{version()}"


class _Files(StaticFiles):
    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        if scope["path_params"].get("version") == version():
            response.headers["Cache-Control"] = _FOREVER
        return response


def mount(app: FastAPI) -> None:
    """Serve the files under `/static/v/{version}`, and under `/static` to whoever knows no version."""
    for prefix in ("/static/v/{version}", "/static"):
        for end, name in ROOTS:
            app.mount(prefix + end, _Files(directory=folder("web") / name, check_dir=False))
