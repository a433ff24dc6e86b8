from __future__ import annotations

import datetime as dt

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from server.models.base import Base, id_column


class Trip(Base):
    """From the first movement to a rest that lasts; open while the vehicle is under way."""

    __tablename__ = "trip"
    __table_args__ = (
        Index("ix_trip_device_id_began_at", "device_id", "began_at"),
        Index("ix_trip_vehicle_id_began_at", "vehicle_id", "began_at"),
    )

    id: Mapped[str] = id_column()
    organisation_id: Mapped[str] = mapped_column(ForeignKey("organisation.id"))
    device_id: Mapped[str] = mapped_column(ForeignKey("device.id"))
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicle.id"))
    boot: Mapped[str] = mapped_column(String(64))
    t_first_s: Mapped[float]
    t_last_s: Mapped[float]
    began_at: Mapped[dt.datetime]
    ended_at: Mapped[dt.datetime]
    under_way: Mapped[bool]
    distance_m: Mapped[float]
    """Speed integrated over time."""
    position_distance_m: Mapped[float]
    """The same way measured between positions: the check."""
    moving_s: Mapped[float]
    max_speed_mps: Mapped[float]
    algorithm: Mapped[str] = mapped_column(String(60))
    input_sha256: Mapped[str] = mapped_column(String(64))
    raw_erased_at: Mapped[dt.datetime | None]
    """Since when some of the data that it was reckoned from are erased."""
    track_erased_at: Mapped[dt.datetime | None]


class TrackPoint(Base):
    """The 1 Hz track."""

    __tablename__ = "track_point"

    trip_id: Mapped[str] = mapped_column(ForeignKey("trip.id", ondelete="CASCADE"), primary_key=True)
    t_s: Mapped[float] = mapped_column(primary_key=True)
    at: Mapped[dt.datetime]
    lat_deg: Mapped[float]
    lon_deg: Mapped[float]
    alt_m: Mapped[float | None]
    speed_mps: Mapped[float | None]
    course_rad: Mapped[float | None]
