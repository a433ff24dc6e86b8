"""Which fixes to believe, how far, and where they belong in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.errors import RangeError
from nav_core.records import Gnss
from nav_core.timebase import stale
from nav_core.typing import Flags, Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """What to expect of a receiver; the defaults are those of an ordinary one with open sky.

    Attributes
    ----------
    position, height : float
        1 sigma of each horizontal axis and of height at the best geometry, m.
    speed, across : float
        1 sigma of speed and, across the track, of course times speed, m/s.
    correlation : float
        Time over which the errors of neighbouring fixes are alike, s.
    position_share, velocity_share : float
        Share of the variance, of position and height and of speed and course, that is correlated; the rest is white.
    max_hdop : float
        Fixes beyond it are left out.
    typical_hdop : float
        At which the sigmas above hold; beyond, they grow in proportion.
    min_sats : float
        Fixes with fewer satellites are left out.
    course_floor : float
        Courses at lower speeds are left out, m/s.
    """

    position: float = 2.0
    height: float = 3.0
    speed: float = 0.08
    across: float = 0.08
    correlation: float = 4.0
    position_share: float = 0.99
    velocity_share: float = 0.5
    max_hdop: float = 6.0
    typical_hdop: float = 1.0
    min_sats: float = 4.0
    course_floor: float = 2.0

    def __post_init__(self) -> None:
        for name in ("position", "height", "speed", "across", "correlation", "typical_hdop"):
            if not getattr(self, name) > 0.0:
                raise RangeError(name, getattr(self, name), "> 0")
        for name in ("position_share", "velocity_share"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise RangeError(name, getattr(self, name), "0 or more and less than 1")

    @property
    def correlated(self) -> Floats:
        """Correlated share of north, east, height, speed and course, shape (5,)."""
        return np.repeat([self.position_share, self.velocity_share], [3, 2])


def believable(gnss: Gnss, receiver: Receiver) -> Flags:
    """Fixes that pass the gates of fix, repetition, geometry and satellites, shape (n,).

    Parameters
    ----------
    gnss : Gnss
        n fixes.
    receiver : Receiver
        Its gates.

    Returns
    -------
    ndarray of bool, shape (n,)
        A fix without `hdop` or `sats` is not judged by them.
    """
    good = gnss.fix & np.isfinite(gnss.lat) & np.isfinite(gnss.lon) & ~stale(gnss)
    return good & ~gnss.poorly_placed(receiver.max_hdop, receiver.min_sats)


class Reports(NamedTuple):
    """Believable fixes at the moments they describe.

    Attributes
    ----------
    t : ndarray, shape (n,)
        s; `course_t` those of the courses.
    z : ndarray, shape (n, 5)
        Latitude, longitude (rad), height (m), speed (m/s), course (rad); NaN where not measured or not to be used.
    noise : ndarray, shape (n, 5, 2)
        Variances: of the error as a whole, and of its white part; the rest is correlated over `Receiver.correlation`.
    """

    t: Floats
    course_t: Floats
    z: Floats
    noise: Floats


def reports(gnss: Gnss, receiver: Receiver, *, speed_lag: float = 0.0, course_lag: float = 0.0) -> Reports:
    """Believable fixes with their noise, moved back by the receiver's lags.

    Parameters
    ----------
    gnss : Gnss
    receiver : Receiver
    speed_lag, course_lag : float
        How much older than its stamp a fix is, s; position and height share the speed's.

    Returns
    -------
    Reports
    """
    good = believable(gnss, receiver)
    t = gnss.t[good]
    z = np.stack([column[good] for column in (gnss.lat, gnss.lon, gnss.alt, gnss.speed, gnss.course)], axis=1)
    z[~(z[:, 3] >= receiver.course_floor), 4] = np.nan
    sigma = np.array([receiver.position, receiver.position, receiver.height, receiver.speed, receiver.across])
    hdop = np.ones(t.size) if gnss.hdop is None else np.nan_to_num(gnss.hdop[good], nan=receiver.typical_hdop)
    alone = (np.maximum(hdop / receiver.typical_hdop, 1.0)[:, None] * sigma) ** 2
    white = alone * (1.0 - receiver.correlated)
    return Reports(t - speed_lag, t - course_lag, z, np.stack((alone, white), axis=2))


def as_white(seen: Reports, receiver: Receiver) -> Floats:
    """Variances for a filter that takes all noise for white, shape (n, 5).

    Noise with variance s² and correlation time T has the same effect over long times as white noise of variance
    ``s² 2 T / dt`` at fixes `dt` apart (the density of a Gauss-Markov process at zero frequency, 000 eq. 3.9.6).

    Parameters
    ----------
    seen : Reports
        n fixes with their noise, m² and (m/s)².
    receiver : Receiver
        Says the correlation time.

    Returns
    -------
    ndarray, shape (n, 5)
        m² and (m/s)², in the order of `Reports.noise`.
    """
    period = float(np.median(np.diff(seen.t))) if seen.t.size > 1 else np.inf
    alone, white = seen.noise[..., 0], seen.noise[..., 1]
    return white + (alone - white) * max(2.0 * receiver.correlation / period, 1.0)
