"""The records that travel through the product: frozen, and validated once when made.

A record's arrays are read-only views; functions that accept a record need not check it again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from nav_core.errors import NotFiniteError, OrderError, RangeError, ShapeError
from nav_core.typing import Flags, Floats

MountingStatus = Literal["ready", "settling", "insufficient", "not_fixed"]
MountingMethod = Literal["whole-drive", "online", "mekf", "two-phase"]


def _column(name: str, values: Floats, *, finite: bool = True) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ShapeError(name, array.shape, "(n,)")
    return _sealed(name, array, finite=finite)


def _triads(name: str, values: Floats, count: int, *, finite: bool = True) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (count, 3):
        raise ShapeError(name, array.shape, f"({count}, 3)")
    return _sealed(name, array, finite=finite)


def _sealed(name: str, array: Floats, *, finite: bool) -> Floats:
    if finite:
        bad = ~np.isfinite(array)
        if bad.any():
            raise NotFiniteError(name, int(np.argwhere(bad)[0][0]))
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def _times(name: str, values: Floats) -> Floats:
    t = _column(name, values)
    steps = np.diff(t)
    if t.size > 1 and steps.min() <= 0.0:
        raise OrderError(name, int(np.argmax(steps <= 0.0)) + 1)
    return t


@dataclass(frozen=True, slots=True)
class Remark:
    """Something about the data that a reader of the result must know.

    Attributes
    ----------
    code : str
        Stable, lower case, e.g. ``"rows_repeated"``.
    detail : str
        One sentence with the numbers.
    """

    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class Inertial:
    """Inertial samples of one box.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Box clock, s, strictly increasing.
    f : ndarray, shape (n, 3)
        Specific force in the A-frame, m/s².
    w : ndarray, shape (n, 3), optional
        Angular rate in the A-frame, rad/s; NaN where not sampled.
    m : ndarray, shape (n, 3), optional
        Magnetic field in the A-frame, µT; NaN where not sampled.
    temp : ndarray, shape (n,), optional
        Temperature, °C; NaN where not sampled.
    """

    t: Floats
    f: Floats
    w: Floats | None = None
    m: Floats | None = None
    temp: Floats | None = None

    def __post_init__(self) -> None:
        t = _times("inertial.t", self.t)
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "f", _triads("inertial.f", self.f, t.size))
        for name in ("w", "m"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, _triads(f"inertial.{name}", values, t.size, finite=False))
        if self.temp is not None:
            temp = _column("inertial.temp", self.temp, finite=False)
            if temp.shape != t.shape:
                raise ShapeError("inertial.temp", temp.shape, f"({t.size},)")
            object.__setattr__(self, "temp", temp)


@dataclass(frozen=True, slots=True)
class Gnss:
    """Satellite fixes of one box, stamped with the box clock when the box got them.

    The stamp is later than the moment the fix describes by the receiver's lag, which may differ
    between speed and course.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Box clock, s, strictly increasing.
    lat, lon : ndarray, shape (n,)
        WGS84, rad; NaN without a fix.
    alt : ndarray, shape (n,)
        Height, m; only differences are used; NaN without a fix.
    speed : ndarray, shape (n,)
        Speed over ground, m/s; NaN without a fix.
    course : ndarray, shape (n,)
        Direction of travel, rad clockwise from true north; NaN where unknown.
    fix : ndarray of bool, shape (n,)
    hdop, sats, utc : ndarray, shape (n,), optional
        Horizontal dilution of precision; satellites used; Unix time of the fix, s.  NaN where unknown.
    """

    t: Floats
    lat: Floats
    lon: Floats
    alt: Floats
    speed: Floats
    course: Floats
    fix: Flags
    hdop: Floats | None = None
    sats: Floats | None = None
    utc: Floats | None = None

    def __post_init__(self) -> None:
        t = _times("gnss.t", self.t)
        object.__setattr__(self, "t", t)
        for name in ("lat", "lon", "alt", "speed", "course", "hdop", "sats", "utc"):
            values = getattr(self, name)
            if values is None:
                continue
            column = _column(f"gnss.{name}", values, finite=False)
            if column.shape != t.shape:
                raise ShapeError(f"gnss.{name}", column.shape, f"({t.size},)")
            object.__setattr__(self, name, column)
        fix = np.ascontiguousarray(self.fix, dtype=np.bool_)
        if fix.shape != t.shape:
            raise ShapeError("gnss.fix", fix.shape, f"({t.size},)")
        fix = fix.view()
        fix.flags.writeable = False
        object.__setattr__(self, "fix", fix)

    def poorly_placed(self, max_hdop: float = 6.0, min_sats: float = 4.0) -> Flags:
        """Fixes whose own dilution of precision or number of satellites speaks against them (000 §5.5).

        Parameters
        ----------
        max_hdop : float
            Largest dilution of use.
        min_sats : float
            Least number of satellites.

        Returns
        -------
        ndarray of bool, shape (n,)
            A fix without either is not judged.
        """
        poor = np.zeros(self.t.size, dtype=np.bool_)
        if self.hdop is not None:
            poor |= self.hdop > max_hdop
        if self.sats is not None:
            poor |= self.sats < min_sats
        return poor

    def rows(self, which: Flags | slice) -> Gnss:
        """Some of the fixes.

        Parameters
        ----------
        which : ndarray of bool, shape (n,), or slice
            Of the n fixes.

        Returns
        -------
        Gnss
            Those; what is not recorded stays so.
        """
        known = {name: getattr(self, name) for name in Gnss.__dataclass_fields__ if getattr(self, name) is not None}
        return Gnss(**{name: values[which] for name, values in known.items()})


@dataclass(frozen=True, slots=True)
class Drive:
    """One recording of one box: inertial samples, fixes, and what was remarked while reading them."""

    inertial: Inertial
    gnss: Gnss
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Outcome of 001 §5.4: longitudinal specific force integrated against GPS speed."""

    passed: bool
    drift: float
    """Difference from GPS speed at the end, m/s."""
    duration: float
    """s."""


@dataclass(frozen=True, slots=True)
class MountingChange:
    """The box was turned in its vehicle.

    Attributes
    ----------
    t : float
        Box clock, s.
    angle : float
        Rotation angle between the mountings before and after, rad.
    before, after : ndarray, shape (3, 3), optional
        R_va before and after; `angle` may be known better than either.
    """

    t: float
    angle: float
    before: Floats | None = None
    after: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("before", "after"):
            R_va = getattr(self, name)
            if R_va is not None:
                object.__setattr__(self, name, _triads(f"change.{name}", R_va, 3))


@dataclass(frozen=True, slots=True)
class Reason:
    """Why an estimate has the status it has, and what the driver can do about it.

    Attributes
    ----------
    code : str
        Stable, e.g. ``"no_turns"``.
    text : str
        A sentence for the driver or installer.
    """

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class MountingEstimate:
    """How a box sits in its vehicle, how sure that is, and why.

    Attributes
    ----------
    status : {"ready", "settling", "insufficient", "not_fixed"}
    method : str
        Which estimator made it.
    R_va : ndarray, shape (3, 3), optional
        ``f_v = R_va @ f_a``.  None when `insufficient` or `not_fixed`.
    covariance : ndarray, shape (3, 3), optional
        Of the small rotation vector, about the V axes, that separates the estimate from the
        truth, rad².  None with `R_va`.
    progress : float
        0..1, the way to `ready`.
    observability : float
        0..1; ``(1 - lmax / trace) * n / (n - 1)`` of the n x n covariance.
    stable, reliable : bool
        The thesis' STABLE and RELIABLE (001 §5.3), or the estimator's counterpart of them.
    self_test : SelfTest, optional
    converged_after : float, optional
        From the first moving fix until every sigma stays under 2°, s.
    speed_lag, course_lag : float, optional
        How late GPS speed and course are against the box clock, s.
    changes : tuple of MountingChange
        Earlier moves of the box within the data; the estimate is the last mounting.
    reasons : tuple of Reason
    """

    status: MountingStatus
    method: MountingMethod
    R_va: Floats | None = None
    covariance: Floats | None = None
    progress: float = 0.0
    observability: float | None = None
    stable: bool = False
    reliable: bool = False
    self_test: SelfTest | None = None
    converged_after: float | None = None
    speed_lag: float | None = None
    course_lag: float | None = None
    changes: tuple[MountingChange, ...] = ()
    reasons: tuple[Reason, ...] = field(default=())

    def __post_init__(self) -> None:
        known = self.status in ("ready", "settling")
        if known != (self.R_va is not None) or known != (self.covariance is not None):
            raise ShapeError("R_va, covariance", (0,), f"both given exactly when known (status {self.status})")
        if self.R_va is not None and self.covariance is not None:
            object.__setattr__(self, "R_va", _triads("R_va", self.R_va, 3))
            object.__setattr__(self, "covariance", _triads("covariance", self.covariance, 3))
        # Plain Python, whatever array code computed them: records are written as JSON.
        for name in ("stable", "reliable"):
            object.__setattr__(self, name, bool(getattr(self, name)))
        if not 0.0 <= self.progress <= 1.0:
            raise RangeError("progress", self.progress, "0..1")

    @property
    def sigma(self) -> Floats | None:
        """1-sigma of the small rotation about V x, y, z, rad, shape (3,); None when unknown."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))
