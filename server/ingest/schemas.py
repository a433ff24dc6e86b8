from __future__ import annotations

import datetime as dt

from pydantic import BaseModel, Field


class WindowRequest(BaseModel):
    """A stretch of its clock that the box is asked to send again or in more detail."""

    t_first_s: float
    t_last_s: float


class Acknowledgement(BaseModel):
    batch_id: str
    duplicate: bool
    next_sequence: int = Field(description="lowest sequence of this boot and stream that is not stored")
    missing: list[tuple[int, int]] = Field(description="inclusive ranges below the highest stored, 100 at most")
    server_time: dt.datetime
    requests: list[WindowRequest]
