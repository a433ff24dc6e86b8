"""What an event is judged in: the stream, what the fixes say of speed, whether the vehicle stood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.level import PLAIN, usual_force
from nav_core.events.record import VehicleClass
from nav_core.events.trigger import Stream
from nav_core.records import Gnss
from nav_core.typing import Floats

STANDS, MOVES = 0.8, 2.0
"""Below and above these speeds a vehicle stands and moves for certain, m/s."""

STILL = 0.16
"""Scatter of the force within 0.2 s at standstill, m/s², with the engine running."""

CARRIED = 1.2
"""Scatter of the force within a second at standstill of a box that is carried about, m/s²: no engine idles so."""

STEADY = 1.0
"""At standstill the force strays by less than this from one half second to the next, m/s²."""


class Scene(NamedTuple):
    """What classification looks at: the stream, when fixes describe what speed, the vehicle's class.

    Attributes
    ----------
    stream : Stream
    fix_t, fix_speed : ndarray, shape (k,)
        Moments that the fixes describe (the lag taken off), s, and their speed, m/s.
    lag_sigma : float
        s.
    vehicle_class : VehicleClass
    level : ndarray, shape (3,)
        Usual force of a vehicle that neither brakes nor turns, m/s²: what the sensor makes of gravity.
    w : ndarray, shape (n, 3), optional
        Angular rate at the samples of the stream, V axes, rad/s; None where it, or the mounting, is not known.
    mounted : bool
        Whether forward and right are known.
    """

    stream: Stream
    fix_t: Floats
    fix_speed: Floats
    lag_sigma: float
    vehicle_class: VehicleClass
    level: Floats
    w: Floats | None = None
    mounted: bool = True

    def speed_before(self, t: float) -> float | None:
        """Speed of the last fix before `t`, at most 5 s old, m/s.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        float or None
            m/s; None where there is no such fix.
        """
        k = int(np.searchsorted(self.fix_t, t - 2.0 * self.lag_sigma)) - 1
        return float(self.fix_speed[k]) if k >= 0 and t - self.fix_t[k] < 5.0 else None

    def speed_after(self, t: float) -> float | None:
        """Speed of the first fix well after `t`, at most 3 s later, m/s.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        float or None
            m/s; None where there is no such fix.
        """
        k = int(np.searchsorted(self.fix_t, t + 0.1 + 2.0 * self.lag_sigma))
        return float(self.fix_speed[k]) if k < self.fix_t.size and self.fix_t[k] - t < 3.0 else None

    def stands_before(self, t: float) -> bool:
        """Whether the vehicle stood before `t`: by the fixes, else by a force that is quiet.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        bool
            False also where neither tells.
        """
        speed, earlier = self.speed_before(t), self.speed_before(t - 2.0)
        if speed is not None:
            return speed < STANDS and (earlier is None or earlier < STANDS)
        scatter = scatter_of(self.stream, t - 2.0, t - 0.1)
        return scatter is not None and scatter < STILL and not self.brakes_before(t)

    def drove_before(self, t: float, *, by_force: bool) -> bool:
        """Whether the vehicle drove before `t`: by the fixes, else by a force neither quiet nor of a carried box.

        Parameters
        ----------
        t : float
            Box clock, s.
        by_force : bool
            Whether the force may tell, where no fix does.

        Returns
        -------
        bool
            False also where neither tells.
        """
        speed = self.speed_before(t)
        if speed is not None or not by_force:
            return speed is not None and speed > MOVES
        scatter = scatter_of(self.stream, t - 2.0, t - 0.1)
        carried = restless(self.stream, t - 3.0, t - 0.5) > CARRIED
        return self.mounted and scatter is not None and not carried and not self.stands_before(t)

    def brakes_before(self, t: float) -> bool:
        """Whether the force before `t` shows a vehicle that slows down, however smoothly.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        bool
            By the two seconds before; False without samples.
        """
        means = [self.stream.mean(begin, begin + 0.45) for begin in (t - 2.0, t - 1.5, t - 1.0, t - 0.55)]
        seen = np.array([mean for mean in means if mean is not None])
        if seen.size == 0:
            return False
        size = np.linalg.norm(seen, axis=1)
        if float(np.median(size)) > np.linalg.norm(self.level) + PLAIN:
            return True
        # Braking by `a` adds to gravity at a right angle; a box that is tilted by hand shows gravity alone.
        stray = float(np.ptp(seen, axis=0).max())
        return stray > STEADY and float(np.ptp(size)) > stray**2 / (4.0 * STANDARD_GRAVITY)


def scene_of(
    stream: Stream,
    gnss: Gnss | None,
    speed_lag: float,
    lag_sigma: float,
    vehicle_class: VehicleClass,
    w: Floats | None = None,
    *,
    mounted: bool = True,
) -> Scene:
    """Scene of a recording.

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    gnss : Gnss or None
        None without fixes.
    speed_lag : float
        Of the receiver, s: a fix describes the speed so long before it came.
    lag_sigma : float
        1 sigma of it, s; more than 0.2 s counts as 0.2 s.
    vehicle_class : VehicleClass
        Sets the force of a road shock.
    w : ndarray, shape (n, 3) or None
        Angular rate at the samples of `stream`, V axes, rad/s.
    mounted : bool
        Whether forward and right are known; else `w` is left out.

    Returns
    -------
    Scene
        V axes; times of fixes less the lag, s.
    """
    none = np.zeros(0)
    fix_t, fix_speed = (none, none) if gnss is None else (gnss.t - speed_lag, gnss.speed)
    level = usual_force(stream.t, stream.f)
    turning = w if mounted else None
    return Scene(stream, fix_t, fix_speed, min(lag_sigma, 0.2), vehicle_class, level, turning, mounted)


def scatter_of(stream: Stream, begin: float, end: float) -> float | None:
    """Usual scatter of the force within fifths of a second, each axis, m/s²; None of less than a second.

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    begin, end : float
        Box clock, s; `end` is not included.

    Returns
    -------
    float or None
        m/s².
    """
    first, last = np.searchsorted(stream.t, [begin, end])
    if last - first < 8 or stream.t[last - 1] - stream.t[first] < 1.0:
        return None
    step = float(np.median(np.diff(stream.t[first:last])))
    width = max(round(0.2 / step), 2)
    part = stream.f[first:last]
    rows = part[: part.shape[0] // width * width].reshape(-1, width, 3)
    return float(np.median(rows.std(axis=1)))


def restless(stream: Stream, begin: float, end: float) -> float:
    """Scatter of the force about its mean, all axes, in the calmer half of a time, m/s²; 0 without samples.

    A box that is carried is never calm; a vehicle that was bumped a moment ago was calm before that, or is since.

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    begin, end : float
        Box clock, s; `end` is not included.

    Returns
    -------
    float
        m/s².
    """
    first, middle, last = np.searchsorted(stream.t, [begin, 0.5 * (begin + end), end])
    halves = [stream.f[first:middle], stream.f[middle:last]]
    return min(float(np.linalg.norm(half.std(axis=0))) if half.shape[0] > 4 else 0.0 for half in halves)
