"""What goes wrong with real recordings, done to simulated drives.

Each function takes a drive and gives another one.  They add what a `Scenario` cannot ask for: a box
that logs something other than specific force, a box that is not fixed, a vehicle that reverses or is
carried, clocks that jump.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from nav_core.errors import TooLittleDataError
from nav_core.records import Drive, Gnss, Inertial
from nav_core.timebase import in_order
from nav_core.typing import Flags, Floats

GRAVITY = 9.80665
_COLUMNS = ("t", "lat", "lon", "alt", "speed", "course", "hdop", "sats", "utc")


def logged_as(drive: Drive, M: Floats) -> Drive:
    """The same drive by a box that logs ``M f``.

    Parameters
    ----------
    drive : Drive
    M : ndarray, shape (3, 3)
        ``-I``: the sign is inverted; ``diag(1, -1, 1)``: the axes are left-handed; ``I / 9.80665``: g.

    Returns
    -------
    Drive
    """
    return replace(drive, inertial=Inertial(t=drive.inertial.t, f=drive.inertial.f @ np.asarray(M).T))


def swaying(drive: Drive, sigma: float, time: float, seed: int) -> Drive:
    """A box that sways in its holder.

    Parameters
    ----------
    drive : Drive
    sigma : float
        1 sigma of the turn about each axis, rad.
    time : float
        Over which it is correlated (first-order Gauss-Markov), s.
    seed : int

    Returns
    -------
    Drive
    """
    t = drive.inertial.t
    step = 0.05
    count = int((t[-1] - t[0]) / step) + 2
    keep = np.exp(-step / time)
    drawn = np.random.default_rng(seed).standard_normal((count, 3))
    angles = sigma * np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drawn, axis=0))
    grid = t[0] + step * np.arange(count)
    turn = np.column_stack([np.interp(t, grid, angles[:, i]) for i in range(3)])
    return _turned(drive, turn)


def slipping(drive: Drive, rate: float, seed: int) -> Drive:
    """A box that slips on and on.

    Parameters
    ----------
    drive : Drive
    rate : float
        Of the random walk of its turn, rad/√s about each axis.
    seed : int

    Returns
    -------
    Drive
    """
    t = drive.inertial.t
    grid = np.arange(t[0], t[-1] + 1.0)
    steps = np.random.default_rng(seed).standard_normal((grid.size, 3))
    walk = rate * np.cumsum(steps, axis=0)
    return _turned(drive, np.column_stack([np.interp(t, grid, walk[:, i]) for i in range(3)]))


def tumbling(drive: Drive, every: float, sigma: float, seed: int) -> Drive:
    """A box that lies about and is thrown from place to place.

    Parameters
    ----------
    drive : Drive
    every : float
        Mean time between throws, s.
    sigma : float
        1 sigma of the turn about each axis, of every place, rad.
    seed : int

    Returns
    -------
    Drive
    """
    rng = np.random.default_rng(seed)
    t = drive.inertial.t
    count = int(3.0 * (t[-1] - t[0]) / every) + 10
    edges = t[0] + np.cumsum(rng.exponential(every, count))
    places = sigma * rng.standard_normal((count + 1, 3))
    return _turned(drive, places[np.searchsorted(edges, t)])


def _turned(drive: Drive, turn: Floats) -> Drive:
    f = Rotation.from_rotvec(turn).apply(np.array(drive.inertial.f))
    return replace(drive, inertial=Inertial(t=drive.inertial.t, f=f))


def backing_up(drive: Drive, R_va: Floats, at: float, *, seed: int, pace: float = 2.5, lasting: float = 14.0) -> Drive:
    """The vehicle reverses and stands again, at a moment at which it stands.

    Parameters
    ----------
    drive : Drive
    R_va : ndarray, shape (3, 3)
        The mounting then.
    at : float
        Box time of a standstill, s; all that comes later is put off.
    seed : int
    pace : float
        Highest speed backwards, m/s.
    lasting : float
        s; half of it again the vehicle stands.

    Returns
    -------
    Drive
        The receiver reports a positive speed and the direction of travel, as receivers do.

    Raises
    ------
    TooLittleDataError
        If nothing was recorded before or after `at`.
    """
    rng = np.random.default_rng(seed)
    t, fixes = drive.inertial.t, drive.gnss
    first, later = int(np.searchsorted(t, at)), int(np.searchsorted(fixes.t, at))
    if not (0 < first < t.size and 0 < later < fixes.t.size):
        raise TooLittleDataError("samples around `at`", 0, 1)
    rate, fix_rate = 1.0 / np.median(np.diff(t)), 1.0 / np.median(np.diff(fixes.t))
    duration = round(1.5 * lasting * fix_rate) / fix_rate
    own = np.arange(1, round(duration * rate)) / rate
    phase = np.clip(own / lasting, 0.0, 1.0)
    v = -pace * np.sin(np.pi * phase) ** 2
    a = np.gradient(v, own)
    w = 0.25 * np.sin(2.0 * np.pi * phase) * (phase < 1.0)
    resting = np.median(drive.inertial.f[first - round(rate) : first], axis=0)
    f = np.stack([a, v * w, np.zeros_like(v)], axis=1) @ R_va + resting
    f += (0.08 + 0.05 * np.abs(v))[:, None] * rng.standard_normal(f.shape)
    moving_t = np.arange(1, round(duration * fix_rate)) / fix_rate
    shown = np.abs(np.interp(moving_t - 0.2, own, v, left=0.0)) + 0.05 * rng.standard_normal(moving_t.size)
    moving = _known_course(fixes, later)
    course = moving + np.pi + np.interp(moving_t, own, np.cumsum(w) / rate)
    course = np.where(shown > 0.5, course, rng.uniform(0.0, 2.0 * np.pi, shown.size))
    inertial = Inertial(
        t=np.concatenate([t[:first], at + own, t[first:] + duration]),
        f=np.concatenate([drive.inertial.f[:first], f, drive.inertial.f[first:]]),
    )
    inserted = {"t": at + moving_t, "speed": np.abs(shown), "course": np.mod(course, 2.0 * np.pi)}
    return replace(drive, inertial=inertial, gnss=_inserted(fixes, later, inserted, duration))


def _known_course(fixes: Gnss, before: int) -> float:
    good = np.flatnonzero(fixes.fix[:before] & (fixes.speed[:before] > 2.0))
    return float(fixes.course[good[-1]]) if good.size else 0.0


def _inserted(fixes: Gnss, place: int, columns: dict[str, Floats], duration: float) -> Gnss:
    """Fixes put between others; what is not given is as before, and time goes on."""
    count = columns["t"].size

    def whole(name: str) -> Floats:
        values: Floats = getattr(fixes, name)
        later = values[place:] + (duration if name in ("t", "utc") else 0.0)
        held = np.full(count, values[place - 1])
        if name == "utc":
            held = held + (columns["t"] - fixes.t[place - 1])
        return np.concatenate([values[:place], columns.get(name, held), later])

    made = {name: whole(name) for name in _COLUMNS if getattr(fixes, name) is not None}
    fix: Flags = np.concatenate([fixes.fix[:place], np.ones(count, dtype=np.bool_), fixes.fix[place:]])
    return Gnss(fix=fix, **made)


def sailing(
    duration: float, seed: int, *, sea: float = 1.0, pace: float = 9.0, engine: float = 0.05, R_va: Floats | None = None
) -> Drive:
    """A vehicle aboard a ferry: it travels, but what the box feels is the sea.

    Parameters
    ----------
    duration : float
        s.
    seed : int
    sea : float
        1 is a fresh breeze: 3° of roll; 0 is a harbour.
    pace : float
        m/s; half of it when turning in a harbour.
    engine : float
        Vibration per sample, m/s².
    R_va : ndarray, shape (3, 3), optional
        The mounting; None draws one.

    Returns
    -------
    Drive
        At 50 Hz with one fix a second.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.02)
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)
    roll = sea * (0.05 * np.sin(2.0 * np.pi * t / 9.0 + phases[0]) + 0.02 * np.sin(2.0 * np.pi * t / 7.1 + phases[1]))
    pitch = sea * 0.02 * np.sin(2.0 * np.pi * t / 6.3 + phases[2])
    heave = sea * 0.3 * np.sin(2.0 * np.pi * t / 8.0 + phases[3])
    fixes = np.arange(0.5, duration, 1.0)
    wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * fixes / 400.0 + phases[4])
    speed = pace * (0.5 + 0.5 * wave)
    turning = 0.6 * np.sin(2.0 * np.pi * fixes / 150.0 + phases[5])
    course = rng.uniform(0.0, 2.0 * np.pi) + turning
    # The vehicle stands anyhow on the deck, so thrust and turning come from anywhere.
    heading = rng.uniform(0.0, 2.0 * np.pi)
    thrust = np.interp(t, fixes, np.gradient(speed, fixes))
    aside = np.interp(t, fixes, speed * np.gradient(turning, fixes))
    c, s = np.cos(heading), np.sin(heading)
    f = np.stack([c * thrust + s * aside + GRAVITY * pitch, c * aside - s * thrust + GRAVITY * roll], axis=1)
    f = np.column_stack([f, heave - GRAVITY]) + engine * rng.standard_normal((t.size, 3))
    flat = np.zeros(fixes.size)
    drawn = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    gnss = Gnss(
        t=fixes,
        lat=0.7 + 1e-6 * fixes,
        lon=flat,
        alt=flat + 2.0 * rng.standard_normal(),
        speed=np.maximum(speed + 0.06 * rng.standard_normal(fixes.size), 0.0),
        course=np.mod(course + 0.08 / np.maximum(speed, 0.5) * rng.standard_normal(fixes.size), 2.0 * np.pi),
        fix=np.ones(fixes.size, dtype=np.bool_),
    )
    return Drive(Inertial(t=t, f=f @ (drawn if R_va is None else R_va)), gnss)


def clock_jumped(drive: Drive, at: float, by: float) -> Drive:
    """The clock of the box jumps.

    Parameters
    ----------
    drive : Drive
    at : float
        When, box time, s.
    by : float
        How far, s.  Back, and what is recorded for that long lies on top of what was.

    Returns
    -------
    Drive
        In order of time, as a reader of files hands it over.
    """
    inertial, gnss = drive.inertial, drive.gnss
    t, fix_t = (np.where(t < at, t, t + by) for t in (inertial.t, gnss.t))
    keep, kept = in_order(t).keep, in_order(fix_t).keep
    columns = {n: getattr(gnss, n)[kept] for n in _COLUMNS[1:] if getattr(gnss, n) is not None}
    return replace(
        drive,
        inertial=Inertial(t=t[keep], f=inertial.f[keep]),
        gnss=Gnss(t=fix_t[kept], fix=gnss.fix[kept], **columns),
    )


def utc_jumped(drive: Drive, at: float, by: float) -> Drive:
    """The receiver's UTC jumps by so many seconds at a box time.

    Parameters
    ----------
    drive : Drive
        Not changed.
    at : float
        Box clock, s.
    by : float
        s.

    Returns
    -------
    Drive
        The same but for `utc`.
    """
    gnss = drive.gnss
    utc = np.full(gnss.t.size, np.nan) if gnss.utc is None else gnss.utc
    return replace(drive, gnss=replace(gnss, utc=np.where(gnss.t < at, utc, utc + by)))
