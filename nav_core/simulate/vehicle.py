"""The exact motion of the vehicle and of the box in it, at any moments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import bilinear, lfilter

from nav_core.rotation import euler_to_matrix
from nav_core.simulate.driver import drive_along
from nav_core.simulate.impact import Shock, slide_time
from nav_core.simulate.route import CELL, draw_bank, draw_slope, lay_out, over_distance
from nav_core.simulate.scenario import MAX_LAG, Impact, Scenario
from nav_core.simulate.spline import Spline
from nav_core.typing import Floats

START = -MAX_LAG
"""Box clock at which the trajectory begins, s."""

_AFTER_END = 0.5
_PATH_STEP = 0.05
_SETTLES = 0.4

Jet = tuple[Floats, Floats, Floats]
Arm = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Motion:
    """The exact motion at n moments.

    Attributes
    ----------
    v, a_x, slope, bank, yaw, pitch, roll : ndarray, shape (n,)
        As in `Truth`.
    R_tv : ndarray, shape (n, 3, 3)
        Attitude of the body.
    velocity, acceleration : ndarray, shape (n, 3)
        Of the box, T, m/s and m/s².
    w : ndarray, shape (n, 3)
        Angular rate of the body, V axes, rad/s.
    """

    v: Floats
    a_x: Floats
    slope: Floats
    bank: Floats
    yaw: Floats
    pitch: Floats
    roll: Floats
    R_tv: Floats
    velocity: Floats
    acceleration: Floats
    w: Floats

    def specific_force(self, gravity: float) -> Floats:
        """Specific force at the box, V axes, m/s², shape (n, 3): ``R_tv^T (a_t - g_t)``.

        Parameters
        ----------
        gravity : float
            m/s².

        Returns
        -------
        ndarray, shape (n, 3)
            V axes, m/s².
        """
        less_gravity = self.acceleration - np.array([0.0, 0.0, gravity])
        return np.einsum("nij,ni->nj", self.R_tv, less_gravity)


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A vehicle on its way: every ingredient of its motion as an analytic function.

    Attributes
    ----------
    speed : Spline
        Speed of the centre as driven, m/s over s.
    curvature, slope, bank : Spline
        Of the road, over the distance driven, 1/m and rad.
    pitch, roll : Spline
        Of the suspension, rad over s.
    course : float
        At the start, rad.
    arm : tuple of float
        Box from the centre, V axes, m.
    crown : float
        The constant part of `bank`, rad.
    shocks : tuple of Shock
    """

    speed: Spline
    curvature: Spline
    slope: Spline
    bank: Spline
    pitch: Spline
    roll: Spline
    course: float
    arm: Arm
    crown: float
    shocks: tuple[Shock, ...] = ()

    def along(self, t: Floats) -> Jet:
        """Distance along the road, m, forward speed, m/s, and its rate, m/s²; each of shape (n,).

        Parameters
        ----------
        t : ndarray, shape (n,)
            Box clock, s.

        Returns
        -------
        Jet
            m, m/s and m/s², each of shape (n,).
        """
        s = self.speed.integral(t)
        v, a, _ = self.speed.jet(t)
        if self.shocks:
            first = self.shocks[0]
            # As the driver left it; of one who brakes the speed settles shortly after the blow's start.
            cruise = self.speed.value(np.array([first.t0 + _SETTLES]))[0]
            travel, left, rate = first.friction(t)
            s = s + cruise * (travel - np.maximum(t - first.t0 - first.duration, 0.0))
            v, a = v + cruise * (left - 1.0), a + cruise * rate
        for shock in self.shocks:
            travel, value, rate = shock.jet(t)
            s, v, a = s + shock.forward * travel, v + shock.forward * value, a + shock.forward * rate
        return s, v, a

    def at(self, t: Floats) -> Motion:
        """The motion at these moments, box clock, s, shape (n,).

        Parameters
        ----------
        t : ndarray, shape (n,)
            Box clock, s.

        Returns
        -------
        Motion
            rad, m/s, m/s², rad/s.
        """
        s, v, a = self.along(t)
        k, k_s, _ = self.curvature.jet(s)
        heading = (self.course + self.curvature.integral(s), k * v, k_s * v**2 + k * a)
        slope = _per_time(self.slope.jet(s), v, a)
        bank = _per_time(self.bank.jet(s), v, a)
        pitch, roll = _sum(slope, self.pitch.jet(t)), _sum(bank, self.roll.jet(t))
        driven, w, w_rate = _turning(heading, pitch, roll)

        forward, climb, sideways = _tangents(heading[0], slope[0])
        velocity = v[:, None] * forward + _to_t(driven, np.cross(w, self.arm))
        acceleration = a[:, None] * forward + v[:, None] * (slope[1][:, None] * climb + heading[1][:, None] * sideways)
        acceleration += _to_t(driven, np.cross(w_rate, self.arm) + np.cross(w, np.cross(w, self.arm)))
        spun = heading
        for shock in self.shocks:
            # Delta-V is that of the box, so the spin an impact gives turns the body about the box.
            travel, value, rate = shock.jet(t)
            velocity += np.outer(shock.sideways * value, shock.across)
            acceleration += np.outer(shock.sideways * rate, shock.across)
            spun = _sum(spun, (shock.turn_rate * travel, shock.turn_rate * value, shock.turn_rate * rate))
        seen, rates = (driven, w) if spun is heading else _turning(spun, pitch, roll)[:2]
        return Motion(v, a, slope[0], bank[0], spun[0], pitch[0], roll[0], seen, velocity, acceleration, rates)

    def position(self, t: Floats) -> Floats:
        """Position of the box, T from where the centre started, m, shape (n, 3).

        Parameters
        ----------
        t : ndarray, shape (n,)
            Box clock, s.

        Returns
        -------
        ndarray, shape (n, 3)
            T axes, m.
        """
        nodes = np.arange(START, max(float(t.max(initial=START)), START) + 2.0 * _PATH_STEP, _PATH_STEP)
        # Two-point Gauss-Legendre per interval: the path has no closed form once it bends.
        inner = 0.5 * _PATH_STEP * (1.0 + np.array([-1.0, 1.0]) / np.sqrt(3.0))
        rates = self._path_velocity((nodes[:-1, None] + inner).ravel()).reshape(-1, 2, 3)
        path = np.concatenate((np.zeros((1, 3)), np.cumsum(0.5 * _PATH_STEP * rates.sum(axis=1), axis=0)))
        position: Floats = CubicHermiteSpline(nodes, path, self._path_velocity(nodes))(t)

        s, _, _ = self.along(t)
        course = self.course + self.curvature.integral(s)
        pitch = self.slope.value(s) + self.pitch.value(t)
        roll = self.bank.value(s) + self.roll.value(t)
        position += euler_to_matrix(roll, pitch, course) @ np.array(self.arm)
        for shock in self.shocks:
            position += np.outer(shock.sideways * shock.jet(t)[0], shock.across)
        return position

    def struck(self, impact: Impact) -> Vehicle:
        """The same vehicle, hit in addition.

        Parameters
        ----------
        impact : Impact
            Delta-V, m/s, and direction, rad.

        Returns
        -------
        Vehicle
            With one more shock.
        """
        at = np.array([impact.t])
        # Adding zero makes 0.0 of -0.0, whose direction is ahead and not behind.
        forward = float(-impact.delta_v * np.cos(impact.pdof)) + 0.0
        sideways = float(-impact.delta_v * np.sin(impact.pdof)) + 0.0
        before = self.at(at)
        speed_after = float(np.hypot(before.v[0] + forward, sideways))
        slide = slide_time(speed_after)
        if self.shocks:
            # What an earlier blow left and what this one takes from it fade together: tyres know only their sum.
            first = self.shocks[0]
            slide = max(slide, first.t0 + first.duration + first.slide - impact.t - impact.duration)
        shock = Shock(
            t0=impact.t,
            duration=impact.duration,
            shape=impact.shape,
            slide=slide,
            forward=forward,
            sideways=sideways,
            across=before.R_tv[0, :, 1],
            turn_rate=impact.yaw_rate_change,
        )
        return replace(self, shocks=(*self.shocks, shock))

    def _path_velocity(self, t: Floats) -> Floats:
        s, v, _ = self.along(t)
        forward, _, _ = _tangents(self.course + self.curvature.integral(s), self.slope.value(s))
        return v[:, None] * forward


def build(scenario: Scenario, rng: np.random.Generator) -> Vehicle:
    """Draw the road and the driver of a scenario.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    rng : Generator
        Advanced.

    Returns
    -------
    Vehicle
        From `START` to the scenario's end.
    """
    route = lay_out(scenario, rng)
    first = scenario.impacts[0] if scenario.impacts else None
    speed, straight_from = drive_along(route, first, START, scenario.duration + _AFTER_END, rng)
    bends = route.curvature.copy()
    bends[min(int(min(straight_from, 1e9) / CELL), bends.size) :] = 0.0
    curvature = over_distance(bends)
    length = CELL * bends.size
    crown = float(rng.choice([-1.0, 1.0]) * rng.uniform(np.radians(0.3), np.radians(1.2)))
    crown = crown if scenario.crown is None else scenario.crown
    course = float(rng.uniform(0.0, 2.0 * np.pi))

    t = np.clip(speed.centres, START, None)
    v, a, _ = speed.jet(t)
    lateral = curvature.value(speed.integral(t)) * v**2
    nodding = np.where(a < 0.0, scenario.dive * a, a)
    vehicle = Vehicle(
        speed=speed,
        curvature=curvature,
        slope=draw_slope(scenario.slope, length, rng),
        bank=draw_bank(scenario.bank, scenario.bank_length, crown, length, rng),
        pitch=Spline(speed.start, speed.step, scenario.body_pitch * _suspended(nodding, speed.step, scenario)),
        roll=Spline(speed.start, speed.step, -scenario.body_roll * _suspended(lateral, speed.step, scenario)),
        course=course if scenario.start_course is None else scenario.start_course,
        arm=scenario.lever_arm,
        crown=crown,
    )
    for impact in scenario.impacts:
        vehicle = vehicle.struck(impact)
    return vehicle


def _suspended(acceleration: Floats, step: float, scenario: Scenario) -> Floats:
    """Acceleration as the body's tilt follows it: a damped second-order lag of unit gain."""
    w = 2.0 * np.pi * scenario.suspension_frequency
    numerator, denominator = bilinear([w**2], [1.0, 2.0 * scenario.suspension_damping * w, w**2], 1.0 / step)
    followed: Floats = np.asarray(lfilter(numerator, denominator, acceleration))
    return followed


def _per_time(jet: Jet, v: Floats, a: Floats) -> Jet:
    """From derivatives by distance to derivatives by time."""
    value, by_s, by_ss = jet
    return value, by_s * v, by_ss * v**2 + by_s * a


def _sum(one: Jet, other: Jet) -> Jet:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def _to_t(R: Floats, vectors: Floats) -> Floats:
    return np.einsum("nij,nj->ni", R, vectors)


def _tangents(heading: Floats, slope: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vector along the road in T and its derivatives by slope and by heading, each (n, 3)."""
    cy, sy, cs, ss = np.cos(heading), np.sin(heading), np.cos(slope), np.sin(slope)
    forward = np.stack((cs * cy, cs * sy, -ss), axis=1)
    climb = np.stack((-ss * cy, -ss * sy, -cs), axis=1)
    sideways = np.stack((-cs * sy, cs * cy, np.zeros_like(cs)), axis=1)
    return forward, climb, sideways


def _turning(yaw: Jet, pitch: Jet, roll: Jet) -> tuple[Floats, Floats, Floats]:
    """Attitude R_tv, body rate and its derivative from yaw, pitch and roll with theirs.

    The kinematics of ``R_tv = Rz(yaw) @ Ry(pitch) @ Rx(roll)``, differentiated once more.
    """
    _, yd, ydd = yaw
    p, pd, pdd = pitch
    r, rd, rdd = roll
    cp, sp, cr, sr = np.cos(p), np.sin(p), np.cos(r), np.sin(r)
    w = np.stack((rd - yd * sp, pd * cr + yd * sr * cp, yd * cr * cp - pd * sr), axis=1)
    w_rate = np.stack(
        (
            rdd - ydd * sp - yd * pd * cp,
            pdd * cr - pd * rd * sr + ydd * sr * cp + yd * (rd * cr * cp - pd * sr * sp),
            ydd * cr * cp - yd * (rd * sr * cp + pd * cr * sp) - pdd * sr - pd * rd * cr,
        ),
        axis=1,
    )
    return euler_to_matrix(r, p, yaw[0]), w, w_rate
