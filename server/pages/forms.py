"""What the pages' forms have in common."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Form, Request
from pydantic import TypeAdapter, ValidationError
from starlette.responses import RedirectResponse, Response

from server.errors import InvalidError

Text = Annotated[str, Form(max_length=500)]
T = TypeVar("T")


def checked(model: type[T] | Any, **fields: object) -> Any:
    """A form's fields as the API would take them; the first that it would not is named."""
    try:
        return TypeAdapter(model).validate_python(fields)
    except ValidationError as error:
        first = error.errors()[0]
        raise InvalidError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def back(path: str) -> Response:
    """To the page that shows what was done."""
    return RedirectResponse(path, 303)


def day(text: str, following: int = 0) -> dt.datetime | None:
    """The beginning of a day of the calendar, UTC, or of one that follows it; nothing where nothing was typed."""
    if not text.strip():
        return None
    try:
        begins = dt.datetime.combine(dt.date.fromisoformat(text.strip()), dt.time(), dt.UTC)
        return begins + dt.timedelta(days=following)
    except (ValueError, OverflowError):
        raise InvalidError(f"{text[:20]!r} is no day such as 2026-03-01") from None


async def _typed(request: Request) -> dict[str, list[str]]:
    """A form whose fields depend on what was chosen, as it was typed."""
    form = await request.form()
    return {name: [str(value) for value in form.getlist(name)] for name in form}


Typed = Annotated[dict[str, list[str]], Depends(_typed)]
