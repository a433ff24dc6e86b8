"""Times that come from outside."""

from __future__ import annotations

import datetime as dt
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime


def _utc(moment: dt.datetime) -> dt.datetime:
    try:
        return moment.astimezone(dt.UTC)
    except OverflowError:
        raise ValueError("in UTC this is before the first or after the last day of the calendar") from None


Moment = Annotated[AwareDatetime, AfterValidator(_utc)]
"""A time in a query or a body, with its zone."""
