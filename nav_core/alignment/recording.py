"""Alignment out of a recording: its longest rest, and whatever the box's sensors say there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from nav_core.alignment.directions import Attitude
from nav_core.alignment.levelling import Gyrocompass, Levelling, gyrocompass, level
from nav_core.alignment.magnetic import GaussNewtonFit, gauss_newton, master_slave
from nav_core.earth import STANDARD_GRAVITY, MagneticField, gravity
from nav_core.errors import TooLittleDataError
from nav_core.kalman import gate
from nav_core.records import Inertial, Reason
from nav_core.sensors.statics import interval_means, static_intervals
from nav_core.typing import Floats

RESTLESS = 0.5
"""Spread of the specific force beyond which nothing is at rest, m/s²: above an idling engine, below any drive."""

SHORTEST = 2.0
"""Shortest rest worth a mean, s."""

BLOCK = 1.0
"""s: means over blocks this long tell the error of the whole mean, whatever the noise's colour within them."""


class Trust(NamedTuple):
    """What is not known about the sensors, 1-sigma of each axis, and how good a heading must be."""

    accelerometer: float = 0.05
    """Bias left, m/s²: 5 mg."""
    gyro: float = np.radians(0.1)
    """Bias left, rad/s: a consumer gyro after switching on."""
    magnetometer: float = 1.0
    """Hard iron and model together, µT: a calibrated sensor away from steel."""
    heading: float = np.radians(5.0)
    """Largest 1-sigma of a heading that is given, rad."""


TRUST = Trust()


class Place(NamedTuple):
    """Where the box stood."""

    lat: float
    """rad."""
    height: float
    """m."""


class Rest(NamedTuple):
    """The stretch that was used, and the means of the sensors in it."""

    begin: float
    """Box clock, s."""
    end: float
    """Box clock, s."""
    samples: int
    f: Floats
    """m/s², shape (3,)."""
    f_noise: float
    """1-sigma of an axis of the mean by the scatter of the blocks, m/s²."""
    w: Floats | None
    w_noise: float
    m: Floats | None
    m_noise: float


class Magnetic(NamedTuple):
    """Heading by the magnetic field, two ways."""

    ruled: Attitude
    """`master_slave`."""
    fitted: GaussNewtonFit
    """`gauss_newton`."""
    plausible: bool
    """Whether strength and inclination are those of the model."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """What a recording tells about the attitude of its box at rest.

    Attributes
    ----------
    rest : Rest, optional
        None if the box was never at rest.
    levelling : Levelling, optional
    compass : Gyrocompass, optional
        None without gyro or place.
    magnetic : Magnetic, optional
        None without magnetometer or field.
    best : Attitude, optional
        The one with the surest heading among those that may be believed; None if none may.
    source : str, optional
        "gyrocompass" or "magnetic".
    reasons : tuple of Reason
        What is missing, and why.
    """

    rest: Rest | None
    levelling: Levelling | None
    compass: Gyrocompass | None
    magnetic: Magnetic | None
    best: Attitude | None
    source: str | None
    reasons: tuple[Reason, ...]


def align(
    inertial: Inertial, *, place: Place | None = None, field: MagneticField | None = None, trust: Trust = TRUST
) -> Alignment:
    """Attitude of a box at its longest rest in a recording.

    Parameters
    ----------
    inertial : Inertial
    place : Place, optional
        Without one there is no gyrocompassing, and gravity is the conventional one.
    field : MagneticField, optional
        Of the place and day.  Without one the magnetometer is not used.
    trust : Trust

    Returns
    -------
    Alignment

    Raises
    ------
    TooLittleDataError
        The recording is shorter than two windows of the search for rest.
    RangeError
        The specific force at rest is not gravity's: wrong units or a broken sensor.
    """
    rest = longest_rest(inertial)
    if rest is None:
        text = f"The specific force never keeps still to {RESTLESS:g} m/s² for {SHORTEST:g} s."
        return Alignment(None, None, None, None, None, None, (Reason("no_rest", text),))
    g = STANDARD_GRAVITY if place is None else float(gravity(place.lat, place.height))
    sigma_f = float(np.hypot(trust.accelerometer, rest.f_noise))
    levelled = level(rest.f, gravity=g, sigma=sigma_f)
    compass = _compass(rest, place, g, sigma_f, trust)
    magnetic = _magnetic(rest, field, g, sigma_f, trust)
    believed: list[tuple[Attitude, str]] = []
    if compass is not None and compass.attitude is not None:
        believed.append((compass.attitude, "gyrocompass"))
    if magnetic is not None and magnetic.plausible and magnetic.ruled.sigma[2] <= trust.heading:
        believed.append((magnetic.ruled, "magnetic"))
    best, source = min(believed, key=lambda one: one[0].sigma[2]) if believed else (None, None)
    reasons = _reasons(rest, place, field, compass, magnetic, trust)
    return Alignment(rest, levelled, compass, magnetic, best, source, reasons)


def longest_rest(inertial: Inertial) -> Rest | None:
    """The longest stretch at rest, or None.

    Parameters
    ----------
    inertial : Inertial
        Of a recording, A-frame.

    Returns
    -------
    Rest or None
        Its bounds, box clock, s, and the means of its readings, A-frame; None where the box never rests.

    Raises
    ------
    TooLittleDataError
    """
    if inertial.t.size < 4:
        raise TooLittleDataError("inertial samples", inertial.t.size, 4)
    found = static_intervals(inertial.t, inertial.f, shortest=SHORTEST)
    if not len(found):
        return None
    begin, end = found[np.argmax(inertial.t[found[:, 1] - 1] - inertial.t[found[:, 0]])]
    means = interval_means(inertial.f, np.array([[begin, end]]))
    # The search takes the calmest part of the recording for rest, whatever that is.
    if float(np.linalg.norm(means.deviation[0])) > RESTLESS:
        return None
    t = inertial.t[begin:end]
    f, f_noise = _mean(t, inertial.f[begin:end])
    w, w_noise = (None, np.nan) if inertial.w is None else _mean(t, inertial.w[begin:end])
    m, m_noise = (None, np.nan) if inertial.m is None else _mean(t, inertial.m[begin:end])
    return Rest(
        float(t[0]),
        float(t[-1]),
        int(end - begin),
        f,
        f_noise,
        w if np.isfinite(w_noise) else None,
        w_noise,
        m if np.isfinite(m_noise) else None,
        m_noise,
    )


def _mean(t: Floats, values: Floats) -> tuple[Floats, float]:
    """Mean (3,) of samples that may be NaN, and its 1-sigma by the scatter of blocks; NaN for fewer than two blocks."""
    sampled = np.isfinite(values).all(axis=1)
    t, values = t[sampled], values[sampled]
    if not t.size:
        return np.full(3, np.nan), np.nan
    block = ((t - t[0]) / BLOCK).astype(np.int64)
    count = np.bincount(block)
    used = count > 0
    sums = np.stack([np.bincount(block, weights=axis) for axis in values.T], axis=1)[used]
    if len(sums) < 2:
        return values.mean(axis=0), np.nan
    means = sums / count[used, None]
    return values.mean(axis=0), float(np.sqrt(np.mean(np.var(means, axis=0, ddof=1)) / len(means)))


def _compass(rest: Rest, place: Place | None, g: float, sigma_f: float, trust: Trust) -> Gyrocompass | None:
    if rest.w is None or place is None:
        return None
    sigma_w = float(np.hypot(trust.gyro, rest.w_noise))
    return gyrocompass(rest.f, rest.w, lat=place.lat, gravity=g, sigma_f=sigma_f, sigma_w=sigma_w, limit=trust.heading)


def _magnetic(rest: Rest, field: MagneticField | None, g: float, sigma_f: float, trust: Trust) -> Magnetic | None:
    if rest.m is None or field is None:
        return None
    sigma_m = float(np.hypot(trust.magnetometer, rest.m_noise))
    ruled = master_slave(rest.f, rest.m, declination=field.declination, sigma_f=sigma_f, sigma_m=sigma_m)
    fitted = gauss_newton(
        rest.f, rest.m, gravity=g, field=field.vector, sigma_f=sigma_f, sigma_m=sigma_m, start=ruled.R_ta
    )
    return Magnetic(ruled, fitted, fitted.converged and fitted.chi2 <= gate(3, 0.999))


def _reasons(
    rest: Rest,
    place: Place | None,
    field: MagneticField | None,
    compass: Gyrocompass | None,
    magnetic: Magnetic | None,
    trust: Trust,
) -> tuple[Reason, ...]:
    reasons: list[Reason] = []
    if rest.w is None:
        reasons.append(Reason("no_gyro", "No angular rate at rest: the Earth's turning cannot show north."))
    elif place is None:
        reasons.append(Reason("no_place", "No position: the Earth's turning at the box is not known."))
    elif compass is not None:
        reasons += compass.reasons
    if rest.m is None:
        reasons.append(Reason("no_magnetometer", "No magnetic field at rest: it cannot show north."))
    elif field is None:
        reasons.append(Reason("no_field_model", "No position and date: the Earth's magnetic field is not known."))
    elif magnetic is not None and not magnetic.plausible:
        measured, expected = float(np.linalg.norm(rest.m)), field.strength
        text = (
            f"The measured field of {measured:.1f} µT does not fit the Earth's {expected:.1f} µT "
            f"(chi square {magnetic.fitted.chi2:.0f} with 3 degrees of freedom): iron nearby, or not calibrated."
        )
        reasons.append(Reason("field_disturbed", text))
    elif magnetic is not None and magnetic.ruled.sigma[2] > trust.heading:
        text = f"The horizontal field is too weak for a heading: 1-sigma {np.degrees(magnetic.ruled.sigma[2]):.1f}°."
        reasons.append(Reason("field_steep", text))
    return tuple(reasons)
