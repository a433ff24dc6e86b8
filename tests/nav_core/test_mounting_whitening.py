"""The whitening filter: compiled against reference, and against a covariance written out in full."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.mounting.echo import echo
from nav_core.mounting.model import UNKNOWNS, Noise
from nav_core.mounting.pitch_plane import pitch_plane
from nav_core.mounting.stretch import blocks_of, prepare, usable_fixes
from nav_core.mounting.whitening import Channel, at_point, matrices, whiten, whiten_reference
from nav_core.mounting.yaw_plane import yaw_plane
from nav_core.signal import decimate
from nav_core.simulate import Scenario, simulate


def _channel(rng: np.random.Generator, steps: int = 25) -> Channel:
    n, k, c = 3, 2, 4
    root = rng.normal(size=(steps, n, n)) * 0.3
    return Channel(
        x0=rng.normal(size=n),
        P0=np.diag(rng.uniform(0.5, 2.0, n)),
        Phi=np.eye(n) + 0.2 * rng.normal(size=(steps, n, n)),
        Q=root @ np.swapaxes(root, 1, 2),
        driven=np.array([0, 2]),
        U=rng.normal(size=(steps, 2, c)),
        grain=rng.uniform(0.0, 0.1, (steps, 2)),
        H=rng.normal(size=(steps, k, n)),
        Y=rng.normal(size=(steps, k, c)),
        r=np.where(rng.random((steps, k)) < 0.2, np.nan, rng.uniform(0.1, 1.0, (steps, k))),
        period=np.zeros(k),
        unknowns=np.array([0, 2, 3]),
    )


@pytest.mark.parametrize("limit", [np.inf, 1.5])
@pytest.mark.parametrize("period", [0.0, 1.0])
def test_compiled_and_reference_agree(limit: float, period: float):
    rng = np.random.default_rng(21)
    channel = _channel(rng)._replace(period=np.array([0.0, period]))
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
    if plane == "pitch":
        channel = pitch_plane(record, truth.R_va, 0.2, Noise())
    else:
        channel = yaw_plane(record, truth.R_va, (0.2, 0.3), Noise())
    block = blocks_of(record.fixes.t, record.fixes.t[0], 5.0)
    p = np.zeros(UNKNOWNS)
    fast = whiten(channel, block, block[-1] + 1, p, limit=3.0)
    slow = whiten_reference(channel, block, block[-1] + 1, p, limit=3.0)
    for one, other in zip(fast, slow, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())


def test_it_is_generalised_least_squares():
    """The evidence equals that of the joint covariance of all measurements."""
    rng = np.random.default_rng(5)
    channel = _channel(rng, steps=8)
    steps, n = channel.Phi.shape[:2]
    c = channel.Y.shape[2]
    # All states as a linear map of (initial state, process noise).
    mean = np.zeros((n, c))
    mean[:, 0] = channel.x0
    rows, prediction = [], []
    cov = np.zeros((n * (steps + 1), n * (steps + 1)))
    cov[:n, :n] = channel.P0
    transfer = np.hstack([np.eye(n), np.zeros((n, n * steps))])
    for i in range(steps):
        mean = channel.Phi[i] @ mean
        mean[channel.driven] += channel.U[i]
        transfer = channel.Phi[i] @ transfer
        transfer[:, n * (i + 1) : n * (i + 2)] += np.eye(n)
        cov[n * (i + 1) : n * (i + 2), n * (i + 1) : n * (i + 2)] = channel.Q[i]
        for m in np.flatnonzero(np.isfinite(channel.r[i])):
            rows.append(channel.H[i, m] @ transfer)
            prediction.append(channel.Y[i, m] - channel.H[i, m] @ mean)
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
    second = channel._replace(**{name: getattr(channel, name)[10:] for name in ("Phi", "Q", "U", "H", "Y", "r")})
    p = np.zeros(4)
    both = whiten(channel, np.arange(20) // 10, 2, p, restart=True)
    alone = whiten(second, np.zeros(10, dtype=np.int64), 1, p)
    np.testing.assert_allclose(both.gram[1], alone.gram[0], rtol=1e-12)


@pytest.mark.parametrize("driven", [0, 1])
def test_the_echo_of_noise_is_that_of_every_step_on_its_own(driven: int):
    """One derivative a step, an impulse of the noise's size; the squares add up."""
    steps = 25
    channel = _channel(np.random.default_rng(8), steps)
    U, Y = np.zeros((steps, 2, 1 + steps)), np.zeros((steps, 2, 1 + steps))
    U[np.arange(steps), driven, 1 + np.arange(steps)] = np.sqrt(channel.grain[:, driven])
    impulses = channel._replace(x0=np.zeros(channel.x0.size), U=U, Y=Y, unknowns=np.arange(steps))
    gram = whiten_reference(impulses, np.zeros(steps, dtype=np.int64), 1, np.zeros(steps)).gram.sum((0, 1))
    assert echo(channel)[driven] == pytest.approx(np.trace(gram[1:, 1:]), rel=1e-9)


def test_a_channel_at_a_point_is_the_channel_there():
    rng = np.random.default_rng(4)
    channel = _channel(rng)._replace(period=np.array([0.0, 1.0]))
    block, p = np.arange(25) // 10, rng.normal(size=5)
    whole, fixed = whiten(channel, block, 3, p, limit=1.5), whiten(at_point(channel, p), block, 3, p, limit=1.5)
    np.testing.assert_allclose(fixed.misfit(p), whole.misfit(p), rtol=1e-9)
    np.testing.assert_allclose(fixed.log_det, whole.log_det, rtol=1e-9)
    np.testing.assert_array_equal(fixed.number, whole.number)


def test_matrices_have_their_entries_and_nothing_else():
    column = np.arange(3.0)
    expected = np.zeros((3, 2, 2))
    expected[:, 0, 1], expected[:, 1, 1] = column, 0.5
    np.testing.assert_array_equal(matrices(3, 2, {(0, 1): column, (1, 1): 0.5}), expected)
