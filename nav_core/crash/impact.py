"""One blow: its samples, what clipping hid, and the distribution of its delta-V."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.crash.case import Case
from nav_core.crash.clipping import Missing, restore
from nav_core.crash.filters import LEAST_RATE, cfc
from nav_core.crash.fuse import Change, Cloud, fuse
from nav_core.crash.gps_after import AFTER, SETTLED, After, after
from nav_core.crash.gps_change import DIVE, DIVE_SIGMA, Before, before, level_before
from nav_core.crash.lacks import Lacks, lacks_of
from nav_core.crash.pulse import Blow, blow_of, steady_before
from nav_core.events.level import Gravity
from nav_core.events.trigger import Stream, Window
from nav_core.records import Gnss
from nav_core.typing import Flags, Floats

MARGIN = 0.5
"""Samples taken along before time zero, s."""

SCALE = 0.004
"""1 sigma of the accelerometer's scale, share."""

ROTATION = np.radians(0.25)
"""1 sigma of the direction of the axes besides the mounting, rad."""

ROUGH = 0.6
"""Samples off the mean of their neighbours by this share of the pulse (rms) are sampled too slowly: what they ring by
is taken as noise that adds up sample by sample."""

GYRO_LATE, SAMPLE_LATE = 0.003, 0.3
"""1 sigma of how much later than the force a turn rate is told, s, and of the same in steps of sampling: filters
differ."""

GYRO_SCALE = 0.02
"""1 sigma of the scale of a gyro and of what it hears of the blow, share."""

UNSEEN_TURN = np.radians(2.0)
"""Without a gyro, 1 sigma of the mean turn within a blow: the fixes tell of axes that are held, the box does not."""

FADES = 0.5
"""Less than this of what acts besides a blow is not looked at closer, m/s²."""

BESIDE = 0.06
"""What acts besides a blow is the mean of so long before and after it, s."""

LEANS = 0.25
"""The suspension follows the mean braking of so long, s."""

LATER_LEVEL = 0.4
"""1 sigma by which gravity along the box's axes changes in a blow that pitches, rolls and turns the vehicle, m/s²."""

LATER_SPEED = 0.6
"""1 sigma of what braking and sliding between two blows leave open of the speed by the fixes, m/s."""

SMOOTH = 0.005
"""What clipping hides of more samples than some 400 a second is looked for in means over so long, s."""

FEW = 0.25
"""With less than this share of its samples clipped, such a mean is as it is: ringing is clipped either way."""

RINGS = 0.006
"""Samples at full scale after a blow are its ringing for up to so long, together, s; more of them are another blow."""

JITTER = 0.025
"""1 sigma of vibration and noise left in an integral, m/s."""

ALIASING = ((10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 1000.0), (0.3, 0.165, 0.12, 0.077, 0.004, 0.002, 0.001))
"""What body ringing may do to delta-V at these rates, 1 sigma, share of it: up to 100 Hz of boxes without an anti-alias
filter (docs/crash.md), from 200 Hz on with a usual one."""


class Impact(NamedTuple):
    """A blow worked out.

    Attributes
    ----------
    blow : Blow
    steady : Gravity
    filled : ndarray, shape (n, 3)
        Acceleration with the estimate where clipped, consistent with `cloud`, m/s².
    clipped : ndarray of bool, shape (n,)
        Of the samples of `blow`.
    clipped_samples : int
        Within the window.
    spread : float
        1 sigma of the logarithm of the missing impulse.
    rough : float
        How far samples are off the mean of their neighbours, share of the pulse.
    lacks : Lacks
    k : int
        Sample of the maximum resultant.
    cloud : Cloud
    known : Before, optional
    seen : After, optional
    from_gps : ndarray, shape (2,), optional
        Delta-V by the fixes alone, m/s.
    """

    blow: Blow
    steady: Gravity
    filled: Floats
    clipped: Flags
    clipped_samples: int
    spread: float
    rough: float
    lacks: Lacks
    k: int
    cloud: Cloud
    known: Before | None
    seen: After | None
    from_gps: Floats | None


def impact_of(case: Case, window: Window, earlier: Impact | None = None) -> Impact:
    """Work out one blow.

    Parameters
    ----------
    case : Case
        The recording.
    window : Window
        Of the case's stream.
    earlier : Impact, optional
        A blow shortly before: gravity and bias are taken from before it, and of the fixes only those after it
        tell the speed.  Where the vehicle then points they do not tell, so they have no say in delta-V.

    Returns
    -------
    Impact
        V axes at time zero, held through the blow; delta-V with its distribution, m/s.
    """
    stream = case.stream
    t0 = float(stream.t[window.zero])
    gnss = case.gnss
    if earlier is None:
        level = level_before(gnss, case.lags, stream, t0) if gnss is not None and case.yaw_known else None
        steady = steady_before(stream, t0, level, float(max(case.sigma[:2])))
    else:
        steady = earlier.steady._replace(sigma=float(np.hypot(earlier.steady.sigma, LATER_LEVEL)))
    leaning = _leaning(stream, steady, t0) if earlier is None else steady
    blow = blow_of(stream, window, leaning, case.w_v, margin=MARGIN, tail=AFTER + 0.1)
    first = int(np.searchsorted(stream.t, blow.t[0]))
    flags = case.saturation.flags[first : first + blow.t.size]
    filled, spread, stray = _restored(case, blow, flags)
    part = slice(blow.zero, blow.last + 1)
    trace = blow.velocity(filled)
    smooth = blow.velocity(structural(case, blow, filled))[part]
    k = blow.zero + int(np.argmax(np.hypot(smooth[:, 0], smooth[:, 1])))

    seen = None
    if earlier is not None:
        known = speed_between(case, earlier, steady, t0)
    else:
        known = None if gnss is None else before(gnss, case.lags, stream, steady, t0)
    if gnss is not None and known is not None and earlier is None and case.yaw_known:
        seen = _seen(case, gnss, known, blow, flags, trace)
    recorded, lacks = blow.v[k, :2], lacks_of(blow, case.rate)
    missing = trace[k, :2] - recorded
    change = Change(
        recorded,
        missing,
        spread,
        _covariance(case, blow, trace[k, :2], k, leaning) + lacks.unsure**2 * np.eye(2),
        _turn(case, blow, filled, k),
        stray,
    )
    gps, covariance = None, None
    if seen is not None and known is not None:
        gps = seen.velocity - np.array([known.speed, 0.0]) - (trace[blow.last, :2] - trace[k, :2])
        covariance = seen.covariance + np.diag([known.sigma**2, 0.0])
        if blow.w is None:
            covariance += UNSEEN_TURN**2 * _across(gps)
    cloud = fuse(change, gps, covariance).reaching(lacks.hidden)
    return Impact(
        blow=blow,
        steady=steady,
        filled=_consistent(blow.a, filled, cloud, recorded, missing),
        clipped=np.asarray(flags.any(axis=1)),
        clipped_samples=int(flags[part].any(axis=1).sum()),
        spread=spread,
        rough=_rough(blow.a[part]),
        lacks=lacks,
        k=k,
        cloud=cloud,
        known=known,
        seen=seen,
        from_gps=gps,
    )


def speed_between(case: Case, earlier: Impact, steady: Gravity, t0: float) -> Before | None:
    """Speed over ground just before a further blow: carried on through the one before it, and by fixes since.

    None when neither tells.  The course is not told: the vehicle may slide any way.

    Parameters
    ----------
    case : Case
        The recording.
    earlier : Impact
        The blow before.
    steady : Gravity
        Gravity and bias, V axes, m/s².
    t0 : float
        Time zero of the further blow, box clock, s.

    Returns
    -------
    Before or None
        Speed and 1 sigma, m/s; the mean of both, weighted by their variances, if both tell.  Course NaN.
    """
    first, told = earlier.blow, list[tuple[float, float, int]]()
    since = float(first.t[first.last])
    if earlier.known is not None and first.t[-1] >= t0:
        trace = first.velocity(earlier.filled)
        gained = np.array([np.interp(t0, first.t, trace[:, axis]) for axis in range(2)]) - trace[earlier.k, :2]
        velocity = earlier.cloud.mean + gained + [earlier.known.speed, 0.0]
        off = earlier.cloud.points - earlier.cloud.mean
        spread = float(np.sqrt(np.einsum("k,kj,kj->", earlier.cloud.weights, off, off) / 2.0))
        sigma = float(np.linalg.norm([spread, earlier.known.sigma, steady.sigma * (t0 - since)]))
        told.append((float(np.hypot(*velocity)), sigma, earlier.known.fixes))
    if case.gnss is not None:
        late = case.gnss.t - case.lags.speed >= since + SETTLED + 2.0 * case.lags.sigma
        seen = before(case.gnss.rows(late), case.lags, case.stream, steady, t0) if late.any() else None
        if seen is not None:
            # What the accelerometer gains of a vehicle that slides sideways is not all along its way.
            told.append((seen.speed, float(np.hypot(seen.sigma, LATER_SPEED)), seen.fixes))
    if not told:
        return None
    weight = np.array([sigma**-2.0 for _, sigma, _ in told])
    speed = float(weight @ [value for value, _, _ in told] / weight.sum())
    return Before(speed, float(weight.sum() ** -0.5), np.nan, np.nan, max(count for _, _, count in told))


def structural(case: Case, blow: Blow, a: Floats) -> Floats:
    """Accelerations after CFC 60 where the sampling allows it, else as they are, shape (n, 3).

    SAE J211-1 has CFC 60 for structural accelerations; a plateau's maximum lies where ringing puts it otherwise.

    Parameters
    ----------
    case : Case
        Says the rate of sampling.
    blow : Blow
        Says the steps.
    a : ndarray, shape (n, 3)
        On the samples of `blow`, m/s².

    Returns
    -------
    ndarray, shape (n, 3)
        m/s², in the axes of `a`.
    """
    if case.rate < LEAST_RATE[60] * (1.0 - 1e-3) or np.ptp(blow.step[1:]) > 0.5 / case.rate:
        return a
    return cfc(a, case.rate, 60)


def _rough(a: Floats) -> float:
    """How far samples (n, 3) are off the mean of their neighbours, rms, share of the rms of all."""
    if a.shape[0] < 8:
        return 0.0
    off = a[1:-1] - 0.5 * (a[2:] + a[:-2])
    return float(np.sqrt(np.mean(off**2) / max(np.mean(a**2), 1e-9)))


def _across(v: Floats) -> Floats:
    """Covariance of a vector (2,) whose direction alone is unsure, by 1 rad."""
    return np.outer([-v[1], v[0]], [-v[1], v[0]])


def _restored(case: Case, blow: Blow, flags: Flags) -> tuple[Floats, float, float]:
    """Acceleration with an estimate in place of what was clipped, its spread and 1 sigma of its direction, rad."""
    begin = max(int(np.searchsorted(blow.t, blow.t[blow.zero] - 0.03)), 0)
    part = slice(begin, blow.last + 1)
    if case.saturation.full_scale is None or not flags[part].any():
        return blow.a, 0.0, 0.0
    H = np.einsum("ji,nkj->nik", case.R_va, blow.C[part])  # R_va^T C^T
    tries: list[tuple[Missing, Floats]] = []
    ends = _beside(blow, flags)
    # When the one gave way to the other is not told, but a wrong guess bends the direction of the flanks.
    unsure = float(np.linalg.norm(ends[1] - ends[0])) / np.sqrt(12.0)
    elapsed = np.clip((blow.t[part] - blow.t[blow.zero]) / max(blow.t[blow.last] - blow.t[blow.zero], 1e-9), 0.0, 1.0)
    for share in (elapsed > 0.0, elapsed, elapsed >= 1.0) if unsure > FADES else (elapsed,):
        beside = np.outer(1.0 - share, ends[0]) + np.outer(share, ends[1])
        tries.append((_smoothly(blow.t[part], blow.a[part] - beside, H, flags[part], unsure), beside))
    known, beside = min(tries, key=lambda each: each[0].bent)
    filled = blow.a.copy()
    filled[part] = known.a + beside
    return filled, known.spread, known.stray


def _smoothly(t: Floats, a: Floats, H: Floats, flags: Flags, unsure: float) -> Missing:
    """`restore` of means over 5 ms, where samples are that many: the body's ringing keeps no direction, the blow does.

    A mean of which many samples were clipped is a bound, as they are.
    """
    cell = np.floor((t - t[0]) / SMOOTH + 1e-6)
    if cell[-1] < 4.0 or t.size < 1.8 * (cell[-1] + 1.0):
        return restore(t, a, H, flags, unsure)
    begin = np.flatnonzero(np.diff(cell, prepend=-1.0))
    count = np.diff(np.append(begin, t.size))
    means = [np.add.reduceat(each, begin, axis=0) / count[:, None] for each in (t[:, None], a, flags.astype(float))]
    known = restore(means[0][:, 0], means[1], H[begin + count // 2], means[2] > FEW, unsure)
    return known._replace(a=a + np.repeat(known.a - means[1], count, axis=0))


def _leaning(stream: Stream, steady: Gravity, t0: float) -> Gravity:
    """Gravity and bias of a body that braking has pitched: through a blow it stays so."""
    now = stream.mean(t0 - LEANS, t0 - 0.005)
    if now is None:
        return steady
    braking = float(now[0] - steady.f[0])
    f = steady.f + np.array([DIVE * braking, 0.0, 0.0])
    return steady._replace(f=f, sigma=float(np.hypot(steady.sigma, DIVE_SIGMA * braking)))


def _beside(blow: Blow, flags: Flags) -> tuple[Floats, Floats]:
    """What acts besides the blow, m/s², (3,): brakes before it, sliding after it.

    It does not point the way of the blow, which is what tells clipped axes from those that did not clip.
    """
    t, whole = blow.t, ~flags.any(axis=1)
    begin, end = float(t[blow.zero]), float(t[blow.last])
    before = whole & (t >= begin - BESIDE) & (t < begin)
    after = whole & (t > end) & (t <= end + BESIDE)
    ends = [blow.a[each].mean(axis=0) if each.any() else np.zeros(3) for each in (before, after)]
    return ends[0], ends[1]


def _seen(case: Case, gnss: Gnss, known: Before, blow: Blow, flags: Flags, trace: Floats) -> After | None:
    """What the fixes say of the velocity after a blow, as far as no further blow is clipped."""
    rest = slice(blow.last, None)
    clipped = np.flatnonzero(np.cumsum(blow.step[rest] * flags[rest].any(axis=1)) > RINGS)
    until = float(blow.t[rest][clipped[0]]) - SETTLED if clipped.size else np.inf
    path = blow.t[rest], trace[rest, :2] - trace[blow.last, :2]
    return after(gnss, case.lags, known, (float(blow.t[blow.zero]), float(blow.t[blow.last])), path, until)


def _covariance(case: Case, blow: Blow, d: Floats, k: int, steady: Gravity) -> Floats:
    """Of a delta-V that was not clipped: level, vibration, scale and sampling."""
    size = float(np.hypot(*d))
    along = d / max(size, 1e-9)
    across = np.array([-along[1], along[0]])
    elapsed = float(blow.t[k] - blow.t[blow.zero])
    every = (steady.sigma * elapsed) ** 2 + JITTER**2
    alias = float(np.interp(np.log(case.rate), np.log(ALIASING[0]), ALIASING[1]))
    pulse = blow.a[blow.zero : blow.last + 1]
    rough = _rough(pulse)
    if rough > ROUGH:
        # Of white noise, a sample is off the mean of its neighbours by 1.5 times the variance.
        noise = rough * float(np.sqrt(np.mean(pulse**2) / 1.5))
        every += noise**2 * max(k - blow.zero, 1) / case.rate**2
    return (
        every * np.eye(2)
        + (SCALE**2 + alias**2) * size**2 * np.outer(along, along)
        + 0.25 * alias**2 * size**2 * np.outer(across, across)
    )


def _turn(case: Case, blow: Blow, filled: Floats, k: int) -> float:
    """1 sigma of the direction of the axes, rad."""
    # Of an open heading no direction is told, and the resultant is as sure as ever.
    mounted = float(case.sigma[2]) if case.yaw_known else 0.0
    late = scale = 0.0
    part = slice(blow.zero, k + 1)
    change = (filled[part, :2] * blow.step[part, None]).sum(axis=0)
    size = float(np.hypot(*change))
    if blow.w is not None and size > 1e-6:
        # What turns the change is the turn, and its rate, that the force along it has met.
        along = (filled[part, :2] @ change) * blow.step[part] / size**2
        late = float(along @ blow.w[part, 2]) * float(np.hypot(GYRO_LATE, SAMPLE_LATE / case.rate))
        scale = GYRO_SCALE * float(along @ np.arctan2(blow.C[part, 1, 0], blow.C[part, 0, 0]))
    return float(np.linalg.norm([mounted, ROTATION, late, scale]))


def _consistent(recorded: Floats, filled: Floats, cloud: Cloud, measured: Floats, missing: Floats) -> Floats:
    """Acceleration whose integral is the delta-V reported: what was missing scaled, then all turned and scaled."""
    a = recorded + cloud.factor * (filled - recorded)
    raw = measured + cloud.factor * missing
    if np.hypot(*raw) < 1e-6:
        return a
    ratio = complex(*cloud.mean) / complex(*raw)
    turned = (a[:, 0] + 1j * a[:, 1]) * ratio
    return np.stack((turned.real, turned.imag, a[:, 2]), axis=1)
