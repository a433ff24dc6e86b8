from __future__ import annotations

import datetime as dt

from pydantic import BaseModel, Field

from server.devices.schemas import Told


class Acknowledgement(BaseModel):
    batch_id: str
    duplicate: bool
    next_sequence: int = Field(description="lowest sequence of this boot and stream that is not stored")
    missing: list[tuple[int, int]] = Field(description="inclusive ranges below the highest stored, 100 at most")
    server_time: dt.datetime
    requests: list[Told] = Field(description="configuration, and windows that the box is asked for")
