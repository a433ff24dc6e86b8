"""What shakes a box without a crash: potholes, speed bumps, kerbs, slammed doors, falls, emergency braking.

Added to a simulated drive after the fact, in the V axes, and clipped again at the box's full scale.  Shapes and sizes
are drawn wide: the aim is what a detector must not take for a crash, not the ride of one car.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.earth import STANDARD_GRAVITY
from nav_core.records import Drive
from nav_core.simulate.scenario import Truth
from nav_core.typing import Floats

ShockName = Literal["pothole", "speed_bump", "kerb", "door_slam", "drop", "emergency_braking", "swerve"]

G = STANDARD_GRAVITY
WHEELBASE = 2.7
HANDLING = 12.0
"""From the hand's first touch to the box back in its place at the least, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shock:
    """One disturbance, as drawn: what it was and when it began, box clock, s."""

    name: ShockName
    t: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rates:
    """How often, per hour of driving or, of doors and drops, per hour of recording.

    A kind only happens where it can: doors and drops at standstill, the others at speed.
    """

    pothole: float = 60.0
    speed_bump: float = 12.0
    kerb: float = 6.0
    door_slam: float = 12.0
    drop: float = 3.0
    emergency_braking: float = 12.0
    swerve: float = 8.0


class _Canvas(NamedTuple):
    """What is being added to: forces in V (n, 3), the vehicle's speed, and what is added to it (n,)."""

    t: Floats
    v: Floats
    f: Floats
    gained: Floats


def shaken(
    drive: Drive, truth: Truth, *, full_scale: float, rates: Rates | None = None, rng: np.random.Generator
) -> tuple[Drive, tuple[Shock, ...]]:
    """A drive with disturbances in it.

    Parameters
    ----------
    drive : Drive
        Without a crash.
    truth : Truth
        Of the same drive.
    full_scale : float
        Of the accelerometer, m/s².
    rates : Rates, optional
    rng : numpy Generator

    Returns
    -------
    Drive
    tuple of Shock
        In order of time.
    """
    rates = rates or Rates()
    t = drive.inertial.t
    canvas = _Canvas(t, truth.v, np.zeros((t.size, 3)), np.zeros(t.size))
    names: list[tuple[ShockName, float]] = [
        ("pothole", rates.pothole),
        ("speed_bump", rates.speed_bump),
        ("kerb", rates.kerb),
        ("door_slam", rates.door_slam),
        ("emergency_braking", rates.emergency_braking),
        ("swerve", rates.swerve),
    ]
    shocks: list[Shock] = []
    hours = float(t[-1] - t[0]) / 3600.0
    for name, rate in names:
        for at in _moments(name, canvas, rng.poisson(rate * hours), rng):
            _ADD[name](canvas, at, rng)
            shocks.append(Shock(name=name, t=at))
    f = drive.inertial.f + canvas.f @ truth.mountings[0][1]  # row by row, R_va^T f
    for at in _moments("drop", canvas, rng.poisson(rates.drop * hours), rng):
        _drop(t, f, at, rng)
        shocks.append(Shock(name="drop", t=at))
    f = np.clip(f, -full_scale, full_scale)
    speed = drive.gnss.speed + np.interp(drive.gnss.t - truth.speed_lag, t, canvas.gained)
    gnss = replace(drive.gnss, speed=np.maximum(speed, 0.0))
    inertial = replace(drive.inertial, f=f)
    return replace(drive, inertial=inertial, gnss=gnss), tuple(sorted(shocks, key=lambda each: each.t))


def _moments(name: ShockName, canvas: _Canvas, count: int, rng: np.random.Generator) -> list[float]:
    """When a kind of shock happens, s: as often as there is room for it."""
    v = canvas.v + canvas.gained
    fits = {
        "pothole": v > 3.0,
        "speed_bump": (v > 3.0) & (v < 14.0),
        "kerb": (v > 1.5) & (v < 12.0),
        "door_slam": v < 0.05,
        "drop": v < 0.05,
        "emergency_braking": v > 8.0,
        "swerve": v > 8.0,
    }[name]
    inside = (canvas.t > canvas.t[0] + 5.0) & (canvas.t < canvas.t[-1] - 25.0)
    where = np.flatnonzero(fits & inside)
    if where.size == 0:
        return []
    times = np.sort(canvas.t[rng.choice(where, size=count)])
    apart = {"emergency_braking": 25.0, "swerve": 8.0, "drop": 40.0}.get(name, 1.0)
    kept: list[float] = []
    for each in times.tolist():
        if not kept or each - kept[-1] > apart:
            kept.append(each)
    return kept


def _put(canvas: _Canvas, begin: float, span: float) -> tuple[slice, Floats]:
    first, last = np.searchsorted(canvas.t, [begin, begin + span])
    return slice(int(first), int(last)), canvas.t[first:last] - begin


def _half_sine(t: Floats, begin: float, length: float) -> Floats:
    x = (t - begin) / length
    return np.where((x > 0.0) & (x < 1.0), np.sin(np.pi * np.clip(x, 0.0, 1.0)), 0.0)


def _ringing(t: Floats, frequency: float, decay: float, phase: float) -> Floats:
    after = np.maximum(t, 0.0)
    return np.where(t > 0.0, np.exp(-after / decay) * np.sin(2.0 * np.pi * frequency * after + phase), 0.0)


def _axles(v: float) -> tuple[float, float]:
    return 0.0, WHEELBASE / max(v, 1.0)


def _speed_at(canvas: _Canvas, t: float) -> float:
    return float(np.interp(t, canvas.t, canvas.v + canvas.gained))


def _pothole(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    part, t = _put(canvas, at, 3.0)
    strength, side = rng.uniform(1.0, 7.0) * G, float(rng.choice([-1.0, 1.0]))
    fall, hit = rng.uniform(0.015, 0.04), rng.uniform(0.012, 0.03)
    back, across = rng.uniform(0.1, 0.4, 2)
    for late in _axles(_speed_at(canvas, at)):
        blow = _half_sine(t, late + fall, hit)
        rest = _ringing(t - late - fall - hit, rng.uniform(9.0, 14.0), rng.uniform(0.05, 0.15), 0.0)
        canvas.f[part, 2] += 0.6 * G * _half_sine(t, late, fall) - strength * blow + 0.2 * strength * rest
        canvas.f[part, 0] += -back * strength * (blow - 0.4 * _half_sine(t, late + fall + hit, 2.0 * hit))
        canvas.f[part, 1] += side * across * strength * (blow - _half_sine(t, late + fall + hit, hit))


def _speed_bump(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    part, t = _put(canvas, at, 6.0)
    v = _speed_at(canvas, at)
    length, height = rng.uniform(0.4, 3.0), rng.uniform(0.04, 0.12)
    span = length / max(v, 1.0)
    strength = min(2.0 * height * (np.pi / span) ** 2, 2.5 * G)
    for late in _axles(v):
        x = (t - late) / span
        canvas.f[part, 2] -= np.where((x > 0.0) & (x < 1.0), strength * np.sin(2.0 * np.pi * x), 0.0)
        canvas.f[part, 0] -= 0.15 * strength * np.where((x > 0.0) & (x < 1.0), np.sin(2.0 * np.pi * x), 0.0)
        canvas.f[part, 2] += 0.3 * strength * _ringing(t - late - span, 1.6, 0.5, 0.0)


def _kerb(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    """A wheel against a kerb: part of the speed is lost for good."""
    part, t = _put(canvas, at, 3.0)
    lost, length = rng.uniform(0.1, 1.0), rng.uniform(0.025, 0.06)
    force = lost * np.pi / (2.0 * length)
    side, up = float(rng.uniform(-0.6, 0.6)), rng.uniform(1.0, 4.0) * G
    blow = _half_sine(t, 0.0, length)
    canvas.f[part, 0] -= force * blow
    canvas.f[part, 1] += side * force * (blow - _half_sine(t, length, length))
    canvas.f[part, 2] -= up * blow - 0.4 * up * _ringing(t - length, 11.0, 0.1, 0.0)
    _gain(canvas, at, -min(lost, _speed_at(canvas, at) - 0.5), length, 3.0)


def _door_slam(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    part, t = _put(canvas, at, 2.0)
    strength, frequency = rng.uniform(0.3, 4.0) * G, rng.uniform(20.0, 60.0)
    direction = rng.standard_normal(3) * np.array([0.4, 1.0, 0.6])
    direction /= np.linalg.norm(direction)
    canvas.f[part] += np.outer(strength * _ringing(t, frequency, rng.uniform(0.01, 0.04), 0.3), direction)
    canvas.f[part, 1] += 0.03 * G * _ringing(t, 1.8, 0.5, 0.0)


def _emergency_braking(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    """Up to 1 g, with the brakes' ramp, the tyres' modulation and, at standstill, the body's swing back."""
    v = _speed_at(canvas, at)
    hard, ramp = rng.uniform(0.45, 1.0) * G, rng.uniform(0.08, 0.3)
    room = float((canvas.v + canvas.gained)[(canvas.t >= at) & (canvas.t <= at + 20.0)].min())
    lost = min(v, room) - rng.uniform(0.5, 2.0)
    if lost < 3.0:
        return
    length = lost / hard + ramp
    part, t = _put(canvas, at, length + 1.5)
    shape = np.clip(t / ramp, 0.0, 1.0) * np.clip((length - t) / rng.uniform(0.05, 0.2), 0.0, 1.0)
    wave = 1.0 + 0.12 * np.sin(2.0 * np.pi * rng.uniform(8.0, 14.0) * t)
    canvas.f[part, 0] -= hard * 1.04 * shape * wave
    canvas.f[part, 0] += 0.25 * hard * _ringing(t - length, 1.6, 0.4, 0.0)
    step = np.gradient(canvas.t[part])
    canvas.gained[part] -= np.cumsum(hard * shape * step)
    total = float((hard * shape * step).sum())
    _recover(canvas, int(part.stop), -total)


def _swerve(canvas: _Canvas, at: float, rng: np.random.Generator) -> None:
    """To one side and back, up to 0.9 g."""
    hard, length = rng.uniform(0.5, 0.9) * G, rng.uniform(1.2, 2.5)
    part, t = _put(canvas, at, length)
    canvas.f[part, 1] += float(rng.choice([-1.0, 1.0])) * hard * np.sin(2.0 * np.pi * t / length)


def _gain(canvas: _Canvas, at: float, change: float, span: float, recovery: float) -> None:
    """A change of speed over `span`, taken back by the driver within `recovery`, in the fixes and the forces."""
    del recovery
    part, t = _put(canvas, at, span)
    canvas.gained[part] += change * np.clip(t / span, 0.0, 1.0)
    _recover(canvas, int(part.stop), change)


def _recover(canvas: _Canvas, first: int, change: float) -> None:
    """The driver takes back a change of speed at 2 m/s²; it holds until then."""
    t = canvas.t[first:] - canvas.t[min(first, canvas.t.size - 1)]
    span = max(abs(change) / 2.0, 0.5)
    left = np.clip(1.0 - t / span, 0.0, 1.0)
    canvas.gained[first:] += change * left
    canvas.f[first:, 0] += np.where(t < span, -change / span, 0.0)


def _drop(t: Floats, f: Floats, at: float, rng: np.random.Generator) -> None:
    """The box is taken off, falls, bounces, lies, and is put back as it was."""
    home = f[max(int(np.searchsorted(t, at)) - 1, 0)].copy()
    home *= G / max(float(np.linalg.norm(home)), 1e-9)
    first, last = np.searchsorted(t, [at, at + HANDLING + rng.uniform(0.0, 6.0)])
    x = t[first:last] - at
    taken, height = rng.uniform(0.5, 2.5), rng.uniform(0.2, 1.5)
    turn = Rotation.from_rotvec(rng.standard_normal(3) * rng.uniform(0.3, 2.0))
    lying = Rotation.from_rotvec(rng.standard_normal(3) * 1.5)
    back = float(x[-1]) - 1.5
    share = np.clip(x / taken, 0.0, 1.0)
    hand = Rotation.from_rotvec(share[:, None] * turn.as_rotvec()).apply(home)
    hand += 1.5 * rng.standard_normal(3) * np.sin(2.0 * np.pi * rng.uniform(1.0, 3.0) * x)[:, None]
    out = np.where((x < taken)[:, None], hand, lying.apply(home))
    fall = np.sqrt(2.0 * height / G)
    begin, speed = taken, G * fall
    direction = rng.standard_normal(3)
    for _ in range(4):
        falling = (x >= begin) & (x < begin + fall)
        out[falling] = 0.4 * rng.standard_normal(3)
        length, bounce = rng.uniform(0.004, 0.014), rng.uniform(0.2, 0.5)
        blow = _half_sine(x, begin + fall, length) * speed * (1.0 + bounce) * np.pi / (2.0 * length)
        direction = direction + 0.8 * rng.standard_normal(3)
        out += np.outer(blow, direction / np.linalg.norm(direction))
        begin, speed = begin + fall + length, speed * bounce
        fall = 2.0 * speed / G
    put = np.clip((x - back) / 1.0, 0.0, 1.0)[:, None]
    turned = Rotation.from_rotvec(put * -lying.as_rotvec()).apply(lying.apply(home))
    out = np.where(x[:, None] > back, turned + (put < 1.0) * 0.8 * rng.standard_normal((x.size, 3)), out)
    f[first:last] = out + 0.08 * rng.standard_normal(out.shape)


_ADD = {
    "pothole": _pothole,
    "speed_bump": _speed_bump,
    "kerb": _kerb,
    "door_slam": _door_slam,
    "emergency_braking": _emergency_braking,
    "swerve": _swerve,
}
