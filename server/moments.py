"""The time, and times that come from outside."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime

Clock = Callable[[], dt.datetime]


def utc_now() -> dt.datetime:
    """The time, unless a test brings its own."""
    return dt.datetime.now(dt.UTC)


def _utc(moment: dt.datetime) -> dt.datetime:
    try:
        return moment.astimezone(dt.UTC)
    except OverflowError:
        raise ValueError("in UTC this is before the first or after the last day of the calendar") from None


Moment = Annotated[AwareDatetime, AfterValidator(_utc)]
"""A time in a query or a body, with its zone."""
