"""Crash reconstruction: what hit, from where, how hard, how sure.

`reconstruct_drive` is the front door.  ``reconstruct`` puts an event together, ``pulse`` has its axes, integral and
filters, ``clipping`` the missing impulse, ``gps_change`` and ``gps_after`` the fixes' own delta-V, ``indices`` and
``injury`` the severity, ``trajectory`` the way and the driver, ``edr`` the element table of 49 CFR 563.
"""

from __future__ import annotations

from nav_core.events.record import CrashEvent, VehicleClass
from nav_core.records import Drive, MountingEstimate

__all__ = ["reconstruct_drive"]


def reconstruct_drive(
    drive: Drive,
    mounting: MountingEstimate,
    *,
    vehicle_class: VehicleClass = "car",
    between: tuple[float, float] | None = None,
) -> tuple[CrashEvent, ...]:
    """Find the events of a recording and reconstruct them.

    Parameters
    ----------
    drive : Drive
        A whole recording, or a burst with what context there is; half a second is enough.
    mounting : MountingEstimate
        Valid at the time of the events.  When it is `insufficient` or `not_fixed`, resultants are still given;
        what needs the vehicle's axes is None.
    vehicle_class : {"car", "van", "truck", "bus", "motorcycle"}
        Thresholds of harsh driving and road shocks.
    between : tuple of float, optional
        Only events of which a blow begins in this span of the box clock, s; the rest of the recording is context.

    Returns
    -------
    tuple of CrashEvent
        In order of `t0`.

    Notes
    -----
    Deterministic: the same input gives the same output to the last bit in one environment.
    """
    from nav_core.crash.reconstruct import events_of

    return events_of(drive, mounting, vehicle_class=vehicle_class, between=between)
