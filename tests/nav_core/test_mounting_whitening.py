"""The whitening filter: compiled against reference, and against a covariance written out in full."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.mounting.blows import cut_out
from nav_core.mounting.echo import echo
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.model import UNKNOWNS, Noise
from nav_core.mounting.pitch_plane import PITCH_OBSERVED, pitch_plane
from nav_core.mounting.planes import PITCH_STATES, YAW_STATES, transitions
from nav_core.mounting.refine import view_of
from nav_core.mounting.stretch import (
    Span,
    at,
    blocks_of,
    gained,
    gained_between,
    gained_reference,
    integrate,
    prepare,
    smoothed,
    smoothed_reference,
    steps_of,
)
from nav_core.mounting.whitening import Channel, at_point, measurements, process_noise, whiten, whiten_reference
from nav_core.mounting.yaw_plane import YAW_OBSERVED, yaw_plane
from nav_core.signal import decimate
from nav_core.simulate import Scenario, simulate


def _channel(rng: np.random.Generator, states: int = PITCH_STATES, steps: int = 25) -> Channel:
    """Coefficients of a plane by chance: what they are made of is no matter to the filter."""
    pitch, c = states == PITCH_STATES, 4
    k = 3 if pitch else 1
    variances = rng.uniform(0.2, 0.5, (states, steps))
    mixed = rng.uniform(-0.2, 0.2, (1 if pitch else 0, steps))
    return Channel(
        x0=rng.normal(size=states),
        P0=np.diag(rng.uniform(0.5, 2.0, states)),
        carry=rng.normal(size=(14 if pitch else 4, steps)) * 0.4,
        Q=np.concatenate([variances, mixed]),
        driven=np.array([0, 1]),
        U=rng.normal(size=(steps, 2, c)),
        grain=rng.uniform(0.0, 0.1, (steps, 2)),
        observed=PITCH_OBSERVED if pitch else YAW_OBSERVED,
        share=rng.normal(size=(k, steps)),
        Y=rng.normal(size=(steps, k, c)),
        r=np.where(rng.random((steps, k)) < 0.2, np.nan, rng.uniform(0.1, 1.0, (steps, k))),
        period=np.zeros(k),
        unknowns=np.array([0, 2, 3]),
    )


both_planes = pytest.mark.parametrize("states", [PITCH_STATES, YAW_STATES])


@pytest.mark.parametrize("limit", [np.inf, 1.5])
@pytest.mark.parametrize("period", [0.0, 1.0])
@both_planes
def test_compiled_and_reference_agree(limit: float, period: float, states: int):
    rng = np.random.default_rng(21)
    channel = _channel(rng, states)
    channel.period[-1] = period
    block = np.arange(25) // 10
    p = rng.normal(size=5)
    fast = whiten(channel, block, 3, p, limit=limit)
    slow = whiten_reference(channel, block, 3, p, limit=limit)
    for one, other in zip(fast, slow, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("plane", ["pitch", "yaw"])
def test_they_agree_on_a_drive(plane: str):
    drive, truth = simulate(Scenario(duration=60.0), seed=2)
    record = prepare(decimate(drive.inertial), usable_fixes(drive.gnss))
    view = view_of(record, truth.R_va, (0.2, 0.3))
    channel = pitch_plane(record, view.along, Noise()) if plane == "pitch" else yaw_plane(record, view.across, Noise())
    block = blocks_of(record.fixes.t, record.fixes.t[0], 5.0)
    p = np.zeros(UNKNOWNS)
    fast = whiten(channel, block, block[-1] + 1, p, limit=3.0)
    slow = whiten_reference(channel, block, block[-1] + 1, p, limit=3.0)
    for one, other in zip(fast, slow, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())


@both_planes
def test_it_is_generalised_least_squares(states: int):
    """The evidence equals that of the joint covariance of all measurements."""
    rng = np.random.default_rng(5)
    channel = _channel(rng, states, steps=8)
    Phi, Q, H = transitions(channel.carry, states), process_noise(channel), measurements(channel)
    steps, n = Phi.shape[:2]
    c = channel.Y.shape[2]
    # All states as a linear map of (initial state, process noise).
    mean = np.zeros((n, c))
    mean[:, 0] = channel.x0
    rows, prediction = [], []
    cov = np.zeros((n * (steps + 1), n * (steps + 1)))
    cov[:n, :n] = channel.P0
    transfer = np.hstack([np.eye(n), np.zeros((n, n * steps))])
    for i in range(steps):
        mean = Phi[i] @ mean
        mean[channel.driven] += channel.U[i]
        transfer = Phi[i] @ transfer
        transfer[:, n * (i + 1) : n * (i + 2)] += np.eye(n)
        cov[n * (i + 1) : n * (i + 2), n * (i + 1) : n * (i + 2)] = Q[i]
        for m in np.flatnonzero(np.isfinite(channel.r[i])):
            rows.append(H[i, m] @ transfer)
            prediction.append(channel.Y[i, m] - H[i, m] @ mean)
    A, E = np.array(rows), np.array(prediction)
    S = A @ cov @ A.T + np.diag(channel.r[np.isfinite(channel.r)])
    expected = E.T @ np.linalg.solve(S, E)
    evidence = whiten(channel, np.zeros(steps, dtype=np.int64), 1, np.zeros(4))
    got = evidence.gram.sum((0, 1))[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    assert evidence.log_det.sum() == pytest.approx(np.linalg.slogdet(S)[1])
    assert evidence.number.sum() == len(rows)
    at = rng.normal(size=4)
    e = E @ np.concatenate([[1.0], at[[0, 2, 3]]])
    assert evidence.misfit(at).sum() == pytest.approx(e @ np.linalg.solve(S, e))


def test_stretches_that_begin_anew_know_nothing_of_each_other():
    channel = _channel(np.random.default_rng(9), steps=20)
    second = channel._replace(
        **{name: getattr(channel, name)[10:] for name in ("U", "Y", "r")},
        **{name: getattr(channel, name)[:, 10:] for name in ("carry", "Q", "share")},
    )
    p = np.zeros(4)
    both = whiten(channel, np.arange(20) // 10, 2, p, restart=True)
    alone = whiten(second, np.zeros(10, dtype=np.int64), 1, p)
    np.testing.assert_allclose(both.gram[1], alone.gram[0], rtol=1e-12)


@pytest.mark.parametrize("driven", [0, 1])
@both_planes
def test_the_echo_of_noise_is_that_of_every_step_on_its_own(driven: int, states: int):
    """One derivative a step, an impulse of the noise's size; the squares add up."""
    steps = 25
    channel = _channel(np.random.default_rng(8), states, steps)
    U, Y = np.zeros((steps, 2, 1 + steps)), np.zeros((steps, len(channel.observed), 1 + steps))
    U[np.arange(steps), driven, 1 + np.arange(steps)] = np.sqrt(channel.grain[:, driven])
    impulses = channel._replace(x0=np.zeros(channel.x0.size), U=U, Y=Y, unknowns=np.arange(steps))
    gram = whiten_reference(impulses, np.zeros(steps, dtype=np.int64), 1, np.zeros(steps)).gram.sum((0, 1))
    assert echo(channel)[driven] == pytest.approx(np.trace(gram[1:, 1:]), rel=1e-9)


@both_planes
def test_a_channel_at_a_point_is_the_channel_there(states: int):
    rng = np.random.default_rng(4)
    channel = _channel(rng, states)
    channel.period[-1] = 1.0
    block, p = np.arange(25) // 10, rng.normal(size=5)
    whole, fixed = whiten(channel, block, 3, p, limit=1.5), whiten(at_point(channel, p), block, 3, p, limit=1.5)
    np.testing.assert_allclose(fixed.misfit(p), whole.misfit(p), rtol=1e-9)
    np.testing.assert_allclose(fixed.log_det, whole.log_det, rtol=1e-9)
    np.testing.assert_array_equal(fixed.number, whole.number)


def test_walks_along_the_ticks_and_their_references_agree():
    drive, truth = simulate(Scenario(duration=90.0), seed=6)
    whole = prepare(decimate(drive.inertial), usable_fixes(drive.gnss))
    record = cut_out(whole, [Span(30.0, 38.0)])
    assert (record.step[1:] == 0.0).any()
    columns = [*(record.f @ truth.R_va.T).T, record.density]
    for lag in (0.0, 0.37):
        steps = steps_of(record, lag)
        np.testing.assert_array_equal(gained(record, steps, columns), gained_reference(record, steps, columns))
    back_and_forth = np.random.default_rng(6).uniform(record.t[0] - 1.0, record.t[-1] + 1.0, 60)
    np.testing.assert_allclose(
        gained_between(record, back_and_forth, columns),
        np.diff(at(record, back_and_forth, integrate(record, np.column_stack(columns))), axis=0),
        rtol=1e-9,
        atol=1e-9,
    )
    for reach in (0.5, 20.0):
        np.testing.assert_array_equal(
            smoothed(record, columns[0], reach), smoothed_reference(record, columns[0], reach)
        )
