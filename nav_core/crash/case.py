"""Everything that the reconstruction of one recording shares: axes, stream, fixes, lags, clock."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from nav_core.crash.clipping import Saturation, saturated
from nav_core.crash.gps_change import Lags, lags_of, usable
from nav_core.errors import TooLittleDataError
from nav_core.events.level import PIECE, SHORT, usual_force
from nav_core.events.trigger import Stream, stream_of
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate, Remark
from nav_core.timebase import ClockFit, fit_clock
from nav_core.typing import Floats

YAW_OPEN = np.pi
"""1 sigma of the heading of a box whose mounting is not known, rad."""

TILT_OPEN = np.radians(3.0)
"""1 sigma of the tilt of a box that is only levelled, rad."""

TOLD = np.radians(20.0)
"""A heading less sure than this says nothing of longitudinal and lateral, rad."""


class Case(NamedTuple):
    """A recording ready to be reconstructed.

    Attributes
    ----------
    drive : Drive
    mounting : MountingEstimate
        That was used.
    R_va : ndarray, shape (3, 3)
        The mounting, or a levelling of unknown heading.
    sigma : ndarray, shape (3,)
        1 sigma about V x, y, z, rad.
    stream : Stream
    w_v : ndarray, shape (n, 3), optional
        Angular rate, V axes, rad/s.
    gnss : Gnss, optional
        Usable fixes.
    lags : Lags
    saturation : Saturation
    rate : float
        Samples per second, Hz.
    clock : ClockFit, optional
    remarks : tuple of Remark
        That hold for every event.
    """

    drive: Drive
    mounting: MountingEstimate
    R_va: Floats
    sigma: Floats
    stream: Stream
    w_v: Floats | None
    gnss: Gnss | None
    lags: Lags
    saturation: Saturation
    rate: float
    clock: ClockFit | None
    remarks: tuple[Remark, ...]

    @property
    def yaw_known(self) -> bool:
        """Whether longitudinal and lateral can be told."""
        return bool(self.sigma[2] < TOLD)


def case_of(drive: Drive, mounting: MountingEstimate) -> Case:
    """Prepare a recording of at least four inertial samples.

    Parameters
    ----------
    drive : Drive
        One recording, A-frame.
    mounting : MountingEstimate
        Of the box; one without `R_va` is replaced by `levelled`, with a remark.

    Returns
    -------
    Case
        The recording in V axes, its lags, clock and remarks.
    """
    inertial = drive.inertial
    remarks: list[Remark] = []
    if mounting.R_va is not None and mounting.sigma is not None:
        R_va, sigma = mounting.R_va, mounting.sigma
        if mounting.status != "ready":
            remarks.append(Remark("mounting_settling", "The mounting was not yet sure; its sigma is carried through."))
    else:
        R_va, sigma = levelled(inertial), np.array([TILT_OPEN, TILT_OPEN, YAW_OPEN])
        remarks.append(Remark("mounting_unknown", f"The mounting is {mounting.status}: only resultants are given."))
    gnss = usable(drive.gnss)
    if gnss is None:
        remarks.append(Remark("no_gps", "No usable fix: no impact speed, no path, no check of delta-V."))
    elif mounting.speed_lag is None:
        remarks.append(Remark("gps_lag_unknown", "The receiver's lag is not known; fixes near the blow are not used."))
    return Case(
        drive=drive,
        mounting=mounting,
        R_va=R_va,
        sigma=sigma,
        stream=stream_of(inertial, R_va),
        w_v=None if inertial.w is None else inertial.w @ R_va.T,
        gnss=gnss,
        lags=lags_of(mounting.speed_lag, mounting.course_lag),
        saturation=saturated(inertial.f),
        rate=1.0 / float(np.median(np.diff(inertial.t))),
        clock=_clock(drive.gnss),
        remarks=tuple(remarks),
    )


def levelled(inertial: Inertial) -> Floats:
    """Mounting of unknown heading that puts the usual specific force straight up, shape (3, 3).

    Parameters
    ----------
    inertial : Inertial
        A-frame, at least one sample.

    Returns
    -------
    ndarray, shape (3, 3)
        ``R_va`` up to a turn about V z; without a force to speak of the box is taken to lie level.
    """
    z = -usual_force(inertial.t, inertial.f, (PIECE, SHORT))
    size = float(np.linalg.norm(z))
    z = z / size if size > 1.0 else np.array([0.0, 0.0, 1.0])
    x: Floats = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    R: Floats = np.stack((x, np.cross(z, x), z)).astype(np.float64)
    return R


def between(drive: Drive, begin: float, end: float) -> Drive:
    """The recording from a moment until before another, box clock, s.

    Parameters
    ----------
    drive : Drive
        One recording, A-frame.
    begin, end : float
        Box clock, s; `end` is not included.

    Returns
    -------
    Drive
        Inertial samples and fixes of ``begin <= t < end``, possibly none; the remarks of `drive`.
    """
    inertial = drive.inertial
    rows = slice(*np.searchsorted(inertial.t, [begin, end]).tolist())
    w, m, temp = (None if values is None else values[rows] for values in (inertial.w, inertial.m, inertial.temp))
    part = Inertial(inertial.t[rows], inertial.f[rows], w, m, temp)
    return replace(
        drive, inertial=part, gnss=drive.gnss.rows(slice(*np.searchsorted(drive.gnss.t, [begin, end]).tolist()))
    )


def _clock(gnss: Gnss) -> ClockFit | None:
    if gnss.utc is None:
        return None
    try:
        return fit_clock(gnss.t, gnss.utc)
    except TooLittleDataError:
        return None
