from __future__ import annotations

import datetime as dt

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column


class Organisation(Base):
    """The tenant: everything below belongs to exactly one."""

    __tablename__ = "organisation"

    id: Mapped[str] = id_column()
    name: Mapped[str] = mapped_column(String(200))
    created_at: Mapped[dt.datetime]
