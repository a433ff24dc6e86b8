from __future__ import annotations

import datetime as dt

from pydantic import BaseModel, ConfigDict, Field


class SignIn(BaseModel):
    model_config = ConfigDict(extra="forbid")

    code: str = Field(min_length=1, max_length=500, description="one-time code, or the administrator's token")


class SessionOut(BaseModel):
    csrf_token: str = Field(description="to be sent as X-CSRF-Token with every request that changes something")


class OpenedSessionOut(SessionOut):
    expires_at: dt.datetime = Field(description="moves on while the session is used")
