"""Problems as answers: RFC 9457 documents for programs, the error page for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import orjson
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response

from server.errors import (
    ConflictError,
    ForbiddenError,
    FullError,
    GoneError,
    InvalidError,
    NotFoundError,
    ProblemError,
    SlowBodyError,
    TooLargeError,
    TooManyRequestsError,
    UnauthenticatedError,
    UnavailableError,
    UnsupportedMediaError,
)
from server.wording import marked

MEDIA_TYPE = "application/problem+json"

_CODES = {
    400: "bad_request",
    404: "not_found",
    405: "method_not_allowed",
    413: "too_large",
    415: "unsupported_media_type",
    422: "invalid",
}


class HttpProblemError(ProblemError):
    """A refusal that the framework raised, in our form."""

    def __init__(self, status: int, title: str, headers: Mapping[str, str] | None = None) -> None:
        self.status, self.title = status, title
        self.headers = headers
        super().__init__(title, code=_CODES.get(status, f"http_{status}"))


class InternalProblemError(ProblemError):
    status, code, title = 500, "internal", "Internal error"


_NO_PAGE = (
    marked("There is no such page"),
    marked("The address is not right, or what it showed is no longer there."),
)
PAGES = {
    "not_found": _NO_PAGE,
    "method_not_allowed": _NO_PAGE,
    "forbidden": (
        marked("This page is not open to you"),
        marked("Your role lacks the permission for it. Whoever manages your organisation's users can give it."),
    ),
    "csrf": (
        marked("This form is out of date"),
        marked("You signed in again since the page was opened. Go back, reload it and send the form once more."),
    ),
    "internal": (
        marked("Something went wrong here"),
        marked("The service could not make this page and has noted why. Try again in a moment."),
    ),
    "unavailable": (
        marked("Not available now"),
        marked("A part of the service does not answer. Try again in a moment."),
    ),
}
"""Heading and sentence for people, by code; other problems speak for themselves."""

_SCHEMA: dict[str, object] = {
    "type": "object",
    "required": ["type", "title", "status", "detail", "code"],
    "properties": {name: {"type": "string"} for name in ("type", "title", "detail", "code")}
    | {"status": {"type": "integer"}},
}
DESCRIBED: tuple[type[ProblemError], ...] = (
    UnauthenticatedError,
    ForbiddenError,
    NotFoundError,
    SlowBodyError,
    ConflictError,
    GoneError,
    TooLargeError,
    UnsupportedMediaError,
    InvalidError,
    TooManyRequestsError,
    UnavailableError,
    FullError,
)


def described(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Problems for a route's description in the list of the API."""
    titles = {error.status: error.title for error in DESCRIBED}
    return {
        status: {"description": titles[status], "content": {MEDIA_TYPE: {"schema": _SCHEMA}}} for status in statuses
    }


def is_api(path: str) -> bool:
    """Whether a path answers programs rather than people."""
    return path.startswith("/api/")


def problem_response(error: ProblemError, connection: HTTPConnection) -> Response:
    """Answer to an error: the error page where a browser asked for a page, else problem+json."""
    headers: dict[str, str] = dict(error.headers or {}) if isinstance(error, HttpProblemError) else {}
    if error.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    retry_after_s = error.extra.get("retry_after_s")
    if isinstance(retry_after_s, int):
        headers["Retry-After"] = str(retry_after_s)
    render = getattr(connection.app.state, "render", None)
    if render is not None and not is_api(connection.url.path) and "text/html" in connection.headers.get("accept", ""):
        page = cast("Response", render("error.html", _page(error, connection), connection=connection))
        page.status_code = error.status
        page.headers.update(headers)
        return page
    document = {
        "type": f"urn:scatola:problem:{error.code}",
        "title": error.title,
        "status": error.status,
        "detail": error.detail,
        "code": error.code,
        **error.extra,
    }
    return Response(orjson.dumps(document, default=str), error.status, headers, media_type=MEDIA_TYPE)


def _page(error: ProblemError, connection: HTTPConnection) -> dict[str, object]:
    title, detail = PAGES.get(error.code, (error.title, error.detail))
    return {
        "request": connection,
        "status": error.status,
        "title": title,
        "detail": detail,
    }


def _invalid(error: RequestValidationError) -> InvalidError:
    # The input itself is not echoed: it may be a secret, and it may not be valid JSON to send back.
    places = [{"where": ".".join(str(part) for part in e["loc"]), "message": str(e["msg"])} for e in error.errors()]
    detail = "; ".join(f"{place['where']}: {place['message']}" for place in places[:5])
    return InvalidError(detail, errors=places[:50])


def install(app: FastAPI) -> None:
    """Make every error that leaves a route a problem."""

    async def on_problem(request: Request, error: Exception) -> Response:
        return problem_response(cast("ProblemError", error), request)

    async def on_invalid(request: Request, error: Exception) -> Response:
        return problem_response(_invalid(cast("RequestValidationError", error)), request)

    async def on_http(request: Request, error: Exception) -> Response:
        http = cast("HTTPException", error)
        return problem_response(HttpProblemError(http.status_code, str(http.detail), http.headers), request)

    app.add_exception_handler(ProblemError, on_problem)
    app.add_exception_handler(RequestValidationError, on_invalid)
    app.add_exception_handler(HTTPException, on_http)
