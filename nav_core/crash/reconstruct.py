"""One event put together from its pulse, the fixes around it and the mounting."""

from __future__ import annotations

from nav_core.events.record import CrashEvent, VehicleClass
from nav_core.records import Drive, MountingEstimate


def events_of(
    drive: Drive,
    mounting: MountingEstimate,
    *,
    vehicle_class: VehicleClass,
    between: tuple[float, float] | None,
) -> tuple[CrashEvent, ...]:
    """As `nav_core.crash.reconstruct_drive`; finds nothing yet."""
    del drive, mounting, vehicle_class, between
    return ()
