"""The attitude filter of 000 at work: modes, resets in uniform motion, rejected measurements (sections 7.7.1, 7.8).

Once a second the attitude is measured from gravity and the magnetic field and compared with what the gyros say.  A
control unit decides what becomes of it: in alignment and in uniform motion gravity rules (master and slave), otherwise
both are weighted (Gauss-Newton) and enter the filter with a variance that grows with the manoeuvre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from nav_core.alignment import Attitude, gauss_newton, master_slave
from nav_core.attitude.quaternion_ekf import QuaternionState, correct, nearest, propagate
from nav_core.attitude.vertical import force_at_rest
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import matrix_to_quaternion, quaternion_to_euler, wrap
from nav_core.typing import Floats, finite

Mode = Literal["alignment", "gps", "no_gps"]
Action = Literal["start", "update", "reset", "rejected"]


class Tuning(NamedTuple):
    """One column of 000 table 7.3.

    Attributes
    ----------
    gyro_density : float
        Gyrcov, (rad/s)²/Hz.
    walk_density : float
        RWncov, (rad/s²)²/Hz.
    quaternion_variance : float
        QuatCOV.
    acceleration_factor : float
        KA, s²/m.
    turn_base : float
        baseR, to the power of the yaw rate in rad/s.
    """

    gyro_density: float
    walk_density: float
    quaternion_variance: float
    acceleration_factor: float
    turn_base: float


TABLE_7_3: Mapping[Mode, Tuning] = {
    "alignment": Tuning((0.1 / 60.0) ** 2, 1e-4, 1e-9, 0.0, 1.0),
    "gps": Tuning((0.1 / 60.0) ** 2, 1e-5, 1e-2, 1.0, 1.5),
    "no_gps": Tuning((0.1 / 60.0) ** 2, 1e-5, 1e-2, 3.0, 6.0),
}


@dataclass(frozen=True, slots=True)
class Control:
    """Settings of the control unit.

    Attributes
    ----------
    period : float
        Between two executions of the filter, s (000: 1 s).
    alignment : float
        How long the box stands still at the start, s.
    uniform_rate : float
        Turn rate below which the motion counts as uniform, rad/s.
    uniform_force : float
        The same for the magnitude of the specific force less gravity, m/s².
    most_residual : float
        Of roll, pitch or yaw; a measurement farther off is rejected, rad.
    hold : float
        s after a reset in which the bias is not corrected (T_KF).
    start_variance : float
        Of the biases at the start, (rad/s)².  000 takes 1e10, which says no more than 1 and costs ten digits.
    tuning : mapping of Mode to Tuning
    """

    period: float = 1.0
    alignment: float = 10.0
    uniform_rate: float = 0.01
    uniform_force: float = 0.05
    most_residual: float = 0.35
    hold: float = 5.0
    start_variance: float = 1.0
    tuning: Mapping[Mode, Tuning] = field(default_factory=lambda: TABLE_7_3)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known of the place and the sensors.

    Attributes
    ----------
    gravity : float
        m/s².
    field : ndarray, shape (3,)
        Magnetic field in T, µT (`nav_core.earth`).
    sigma_f, sigma_m : float
        1-sigma of a sample's components, m/s² and µT.
    """

    gravity: float
    field: Floats
    sigma_f: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Tick:
    """One decision of the control unit.

    Attributes
    ----------
    index : int
        Of the sample at whose end it was taken.
    mode : Mode
    action : Action
    variance : float
        Of the measured quaternion's components: eq. 7.7.8 and what the sensors' noise makes of it; NaN unless updated.
    residual : float
        Largest difference of roll, pitch, yaw, measured less estimated, rad.
    """

    index: int
    mode: Mode
    action: Action
    variance: float
    residual: float


@dataclass(frozen=True, slots=True)
class Controlled:
    """Attitude after each sample, and what the control unit did.

    Attributes
    ----------
    q_tv : ndarray, shape (n, 4)
        NaN before the first tick.
    bias : ndarray, shape (n, 3)
        rad/s.
    ticks : tuple of Tick
    state : QuaternionState
        At the end.
    """

    q_tv: Floats
    bias: Floats
    ticks: tuple[Tick, ...]
    state: QuaternionState


def measurement_variance(tuning: Tuning, excess: float, yaw_rate: float) -> float:
    """Variance of the measured quaternion's components in a manoeuvre (000 eq. 7.7.8).

    Parameters
    ----------
    tuning : Tuning
    excess : float
        Magnitude of the specific force less gravity, m/s².
    yaw_rate : float
        rad/s, of either sign: the print takes it as it is and trusts left turns more than right ones.

    Returns
    -------
    float
        ``QuatCOV 10^sqrt(KA |excess|) baseR^|r|``.
    """
    growth = 10.0 ** np.sqrt(tuning.acceleration_factor * abs(excess))
    return float(tuning.quaternion_variance * growth * tuning.turn_base ** abs(yaw_rate))


def run_controlled(
    f: Floats,
    w: Floats,
    m: Floats,
    period: float,
    surroundings: Surroundings,
    *,
    speed: Floats | None = None,
    speed_rate: Floats | None = None,
    control: Control | None = None,
) -> Controlled:
    """Attitude over a record under the control unit.

    Parameters
    ----------
    f, w, m : ndarray, shape (n, 3)
        Specific force, m/s², turn rate, rad/s, and magnetic field, µT, calibrated, V axes.
    period : float
        Between samples, s.
    surroundings : Surroundings
    speed, speed_rate : ndarray, shape (n,), optional
        GPS speed, m/s, and its derivative, m/s², NaN where there is none (`vertical.speed_and_rate`).
    control : Control, optional

    Returns
    -------
    Controlled

    Raises
    ------
    ShapeError, NotFiniteError
    RangeError
        The control's period is shorter than the samples'.
    """
    control = Control() if control is None else control
    n = w.shape[0]
    blank = np.full(n, np.nan)
    record = _Record(f, w, m, blank if speed is None else speed, blank if speed_rate is None else speed_rate)
    for name, values in zip(("f", "w", "m"), (f, w, m), strict=True):
        if values.shape != (n, 3):
            raise ShapeError(name, values.shape, f"({n}, 3)")
        finite(name, values)
    every = round(control.period / period)
    if every < 1:
        raise RangeError("period of the control unit", control.period, f"at least {period:g} s")
    if n < every:
        raise RangeError("duration", n * period, f"at least {control.period:g} s")
    q_out, b_out = np.full((n, 4), np.nan), np.zeros((n, 3))
    settled = record.means(0, every) if control.alignment >= control.period else record.sample(every - 1)
    state, held_until = _start(_by_gravity(settled, surroundings), control), -np.inf
    q_out[every - 1] = state.q_nb
    ticks = [Tick(every - 1, _mode(record, every - 1, control.period, control), "start", np.nan, 0.0)]
    for first in range(every, n, every):
        last = min(first + every, n) - 1
        now = (last + 1) * period
        mode = _mode(record, last, now, control)
        before = state.bias
        state, q_out[first : last + 1] = propagate(state, w[first : last + 1], period, *control.tuning[mode][:2])
        b_out[first : last + 1] = before
        if last - first + 1 < every:
            break
        sample = record.means(first, last + 1) if mode == "alignment" else record.sample(last)
        state, tick = _decide(
            state, sample, Tick(last, mode, "update", np.nan, 0.0), surroundings, control, now < held_until
        )
        if tick.action == "reset":
            held_until = now + control.hold
        ticks.append(tick)
        q_out[last], b_out[last] = state.q_nb, state.bias
    return Controlled(q_out, b_out, tuple(ticks), state)


class _Sample(NamedTuple):
    """What a measurement of the attitude is made of; `share` is its noise over that of a sample."""

    f: Floats
    w: Floats
    m: Floats
    u: float
    u_rate: float
    share: float


class _Record(NamedTuple):
    f: Floats
    w: Floats
    m: Floats
    u: Floats
    u_rate: Floats

    def sample(self, k: int) -> _Sample:
        return _Sample(self.f[k], self.w[k], self.m[k], float(self.u[k]), float(self.u_rate[k]), 1.0)

    def means(self, first: int, end: int) -> _Sample:
        """Over a stretch at rest, where GPS has nothing to add."""
        f, w, m = (np.asarray(values[first:end].mean(axis=0)) for values in (self.f, self.w, self.m))
        return _Sample(f, w, m, np.nan, np.nan, float(1.0 / np.sqrt(end - first)))


def _mode(record: _Record, k: int, now: float, control: Control) -> Mode:
    if now <= control.alignment:
        return "alignment"
    return "no_gps" if np.isnan(record.u_rate[k]) else "gps"


def _by_gravity(sample: _Sample, place: Surroundings) -> Attitude:
    declination = float(np.arctan2(place.field[1], place.field[0]))
    sigma_f, sigma_m = sample.share * place.sigma_f, sample.share * place.sigma_m
    return master_slave(sample.f, sample.m, declination=declination, sigma_f=sigma_f, sigma_m=sigma_m)


def _by_both(sample: _Sample, rate: Floats, place: Surroundings) -> Attitude:
    at_rest = force_at_rest(sample.f, rate, np.asarray(sample.u), np.asarray(sample.u_rate))
    fit = gauss_newton(
        at_rest, sample.m, gravity=place.gravity, field=place.field, sigma_f=place.sigma_f, sigma_m=place.sigma_m
    )
    return fit.attitude


def _variance(fix: Attitude) -> float:
    """Mean variance of the quaternion's components: a quarter of the rotation's."""
    return float(np.trace(fix.covariance)) / 12.0


def _start(fix: Attitude, control: Control) -> QuaternionState:
    P = np.diag(np.concatenate([np.full(4, _variance(fix)), np.full(3, control.start_variance)]))
    return QuaternionState(matrix_to_quaternion(fix.R_ta), np.zeros(3), P)


def _reset(state: QuaternionState, fix: Attitude) -> QuaternionState:
    """Attitude as measured, bias as it was (000 eq. 7.4.3)."""
    P = np.zeros((7, 7))
    P[:4, :4] = _variance(fix) * np.eye(4)
    P[4:, 4:] = state.P[4:, 4:]
    return QuaternionState(nearest(matrix_to_quaternion(fix.R_ta), state.q_nb), state.bias, P)


def _residual(fix: Attitude, state: QuaternionState) -> float:
    return float(np.max(np.abs(wrap(fix.euler - quaternion_to_euler(state.q_nb)))))


def _decide(
    state: QuaternionState, sample: _Sample, tick: Tick, place: Surroundings, control: Control, held: bool
) -> tuple[QuaternionState, Tick]:
    """Reset in uniform motion, update otherwise, unless the measurement is too far off (000 section 7.8 a, g)."""
    aligning = tick.mode == "alignment"
    rate, excess = sample.w - state.bias, float(np.linalg.norm(sample.f)) - place.gravity
    uniform = float(np.linalg.norm(rate)) < control.uniform_rate and abs(excess) < control.uniform_force
    fix = _by_gravity(sample, place) if aligning or uniform else _by_both(sample, rate, place)
    residual = _residual(fix, state)
    if uniform and not aligning:
        return _reset(state, fix), replace(tick, action="reset", residual=residual)
    measured = nearest(matrix_to_quaternion(fix.R_ta), state.q_nb)
    too_far = residual > control.most_residual and not aligning
    if too_far or float(np.linalg.norm(measured - state.q_nb)) >= 1.0:
        return state, replace(tick, action="rejected", residual=residual)
    # Table 7.3 takes the alignment for exact; sensors are noisy at rest too.
    variance = measurement_variance(control.tuning[tick.mode], excess, float(rate[2])) + _variance(fix)
    after = correct(state, measured, variance, hold_bias=held).state
    return after, replace(tick, variance=variance, residual=residual)
