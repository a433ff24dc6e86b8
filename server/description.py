"""The API's description, completed where the framework does not look: who may call, what any route may answer."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from server.accounts.cookie import COOKIE
from server.accounts.gate import DEVICE_PATHS
from server.problems import described

_METHODS = ("get", "put", "post", "patch", "delete")
_SCHEMES: dict[str, dict[str, str]] = {
    "token": {
        "type": "http",
        "scheme": "bearer",
        "description": "an API key (`sck_...`), which may do some things, or the administrator's token, which may all",
    },
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": COOKIE,
        "description": "of a signed-in browser; what changes something also needs the session's `X-CSRF-Token`",
    },
    "box": {"type": "http", "scheme": "bearer", "description": "a box's token (`scd_...`), at its own addresses alone"},
    "signature": {
        "type": "apiKey",
        "in": "header",
        "name": "Authorization",
        "description": "`Scatola-HMAC-SHA256 ...`: a box signs instead of sending its token (docs/device-protocol.md)",
    },
}
_PEOPLE: list[dict[str, list[str]]] = [{"token": []}, {"session": []}]
_BOXES: list[dict[str, list[str]]] = [{"box": []}, {"signature": []}]


def install(app: FastAPI) -> None:
    """Complete the description when it is first asked for."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        fresh = app.openapi_schema is None
        schema = plain()
        if fresh:
            _complete(schema)
        return schema

    app.openapi = openapi


def _complete(schema: dict[str, Any]) -> None:
    schema["components"]["securitySchemes"] = _SCHEMES
    for path, operations in schema["paths"].items():
        for method in _METHODS:
            if method in operations:
                operation: dict[str, Any] = operations[method]
                operation["security"] = _security(path, method)
                for status, problem in described(*_statuses(path, method, operation)).items():
                    operation["responses"].setdefault(str(status), problem)


def _security(path: str, method: str) -> list[dict[str, list[str]]]:
    if path == "/api/v1/claim" or (path == "/api/v1/auth/session" and method == "post"):
        return []
    return _BOXES if path in DEVICE_PATHS else _PEOPLE


def _statuses(path: str, method: str, operation: dict[str, Any]) -> list[int]:
    """What any such route may answer: the database is away, the disk full, the body large, the event erased."""
    found = [503]
    if method != "get":
        found.append(507)
    if "requestBody" in operation:
        found.append(413)
    if "{event_id}" in path:
        found.append(410)
    return found
