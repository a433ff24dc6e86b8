"""How a box sits in its vehicle: several estimators behind one door."""

from __future__ import annotations

from typing import Literal, get_args

from nav_core.errors import NavigationError
from nav_core.records import Drive, MountingEstimate, MountingMethod

__all__ = ["UnknownMethodError", "estimate_mounting"]


class UnknownMethodError(NavigationError):
    """No estimator answers to this name."""

    def __init__(self, method: str, known: tuple[str, ...]) -> None:
        self.method, self.known = method, known
        super().__init__(f"method {method!r} is not known, expected one of {', '.join(known)}")


def estimate_mounting(
    drive: Drive, *, method: MountingMethod = "whole-drive", traffic_side: Literal["left", "right"] | None = None
) -> MountingEstimate:
    """Mounting of the box in a recording.

    Parameters
    ----------
    drive : Drive
    method : {"whole-drive", "online", "mekf", "two-phase"}
        The default uses all of the recording at once; "online" is what a live box shows; "mekf" is the
        filter of 001 ch. 4-6, "two-phase" the baseline of its §3.5.
    traffic_side : {"left", "right"}, optional
        Where it is known, the default also knows to which side roads fall: roll gets twice as sharp.

    Returns
    -------
    MountingEstimate

    Raises
    ------
    UnknownMethodError
        If there is no such estimator.
    """
    if method == "whole-drive":
        from nav_core.mounting.model import roads_of
        from nav_core.mounting.whole_drive import estimate as estimate_whole
        from nav_core.signal import decimate

        return estimate_whole(decimate(drive.inertial), drive.gnss, noise=roads_of(traffic_side))
    if method == "mekf":
        from nav_core.mounting.thesis import estimate_thesis

        return estimate_thesis(drive)
    if method == "online":
        from nav_core.mounting.online_verdict import estimate as estimate_online

        return estimate_online(drive)
    if method == "two-phase":
        from nav_core.mounting.two_phase import estimate as estimate_in_two_phases

        return estimate_in_two_phases(drive)
    raise UnknownMethodError(method, get_args(MountingMethod))
