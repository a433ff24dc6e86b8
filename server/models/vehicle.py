from __future__ import annotations

import datetime as dt

from sqlalchemy import CheckConstraint, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column

VEHICLE_CLASSES = ("car", "van", "truck", "bus", "motorcycle")
TRAFFIC_SIDES = ("right", "left")


class Vehicle(Base):
    """What carries a box."""

    __tablename__ = "vehicle"
    __table_args__ = (
        CheckConstraint(f"vehicle_class IN {VEHICLE_CLASSES}", name="class"),
        CheckConstraint(f"traffic_side IN {TRAFFIC_SIDES}", name="traffic_side"),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"), index=True)
    name: Mapped[str] = mapped_column(String(200))
    plate: Mapped[str | None] = mapped_column(String(20))
    vehicle_class: Mapped[str] = mapped_column(String(20), default="car")
    traffic_side: Mapped[str | None] = mapped_column(String(5))
    created_at: Mapped[dt.datetime]


class Assignment(Base):
    """Which box sat in which vehicle, from when to when; the open one has no end."""

    __tablename__ = "assignment"
    __table_args__ = (Index("ix_assignment_device_id_began_at", "device_id", "began_at"),)

    id: Mapped[str] = id_column()
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    vehicle_id: Mapped[str] = mapped_column(ForeignKey("vehicle.id"), index=True)
    began_at: Mapped[dt.datetime]
    ended_at: Mapped[dt.datetime | None]
