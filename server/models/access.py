from __future__ import annotations

import datetime as dt
from typing import Any

from sqlalchemy import ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column


class SignInCode(Base):
    """A one-time code that opens a session; only its hash is kept."""

    __tablename__ = "sign_in_code"

    code_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    created_at: Mapped[dt.datetime]
    expires_at: Mapped[dt.datetime]
    used_at: Mapped[dt.datetime | None]
    user_id: Mapped[str | None] = mapped_column(ForeignKey("user_account.id"))
    """Whom it signs in; an administrator without an account where there is none."""


class WebSession(Base):
    """A signed-in browser; the cookie's hash, never the cookie."""

    __tablename__ = "web_session"

    id: Mapped[str] = id_column()
    token_hash: Mapped[str] = mapped_column(String(64), unique=True)
    csrf_token: Mapped[str] = mapped_column(String(64))
    user_id: Mapped[str | None] = mapped_column(ForeignKey("user_account.id"))
    by_code: Mapped[bool] = mapped_column(default=False)
    """Opened with a one-time code, so that a forgotten password may be replaced without knowing it."""
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    created_at: Mapped[dt.datetime]
    expires_at: Mapped[dt.datetime]
    preferences: Mapped[dict[str, Any]] = mapped_column(default=dict)
    """Of whoever has no account to keep them with."""


class ViewTicket(Base):
    """Short-lived permission to open one 3D view; it stands in the view's path."""

    __tablename__ = "view_ticket"

    ticket_hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id", ondelete="CASCADE"))
    event_id: Mapped[str | None] = mapped_column(String(32))
    """The one event whose replay it opens besides; the replay follows the vehicle's way."""
    expires_at: Mapped[dt.datetime]
