"""Kalman filters against filterpy, batch least squares and their own claims; kernels against matrices."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core import kalman, processes
from nav_core.errors import CovarianceError, RangeError, ShapeError
from nav_core.kalman import ContinuousModel, Observation, Step, kernels

PV = processes.position_velocity_discrete(0.2, 0.5)
SEEN = np.array([[1.0, 0.0]])
SEEDS = st.integers(0, 2**32 - 1)
# The first example waits for the compiler.
examples = settings(deadline=None, max_examples=50)


def problem(seed: int, n: int = 5, m: int = 3):
    """A random update: state, covariance, residual, measurement matrix, variances."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    P = root @ root.T + 0.1 * np.eye(n)
    return rng.standard_normal(n), P, rng.standard_normal(m), rng.standard_normal((m, n)), rng.uniform(0.1, 3.0, m)


def record(seed: int, steps: int = 60):
    """A walk of the PV model, its measurements and the filter's start."""
    rng = np.random.default_rng(seed)
    P = np.diag([4.0, 1.0])
    start = rng.multivariate_normal(np.zeros(2), P)
    truth = processes.sample_path(PV, start, steps - 1, rng)
    z = truth[:, :1] + 1.5 * rng.standard_normal((steps, 1))
    return truth, z, np.zeros(2), P


# One step -----------------------------------------------------------------------------------------------------


@examples
@given(seed=SEEDS)
def test_one_by_one_is_the_joint_update(seed):
    x, P, e, H, r = problem(seed)
    joint = kalman.update(x, P, e, H, np.diag(r))
    dx, covariance, chi2 = np.zeros(5), P.copy(), np.empty(3)
    assert kernels.update_sequential(dx, covariance, e, H, r, np.inf, chi2, kernels.room_for(5)) == 3
    assert x + dx == pytest.approx(joint.x, rel=1e-7, abs=1e-9)
    assert covariance == pytest.approx(joint.P, rel=1e-7, abs=1e-9)
    assert (covariance == covariance.T).all()
    assert chi2.sum() == pytest.approx(joint.nis, rel=1e-7)


@examples
@given(seed=SEEDS)
def test_correlated_measurements_are_folded_in_once_decorrelated(seed):
    x, P, e, H, _ = problem(seed)
    root = np.random.default_rng(seed + 1).standard_normal((3, 3))
    R = root @ root.T + 0.2 * np.eye(3)
    joint = kalman.update(x, P, e, H, R)
    white, rows = kalman.decorrelated(e, H, R)
    dx, covariance, chi2 = np.zeros(5), P.copy(), np.empty(3)
    kernels.update_sequential(dx, covariance, white, rows, np.ones(3), np.inf, chi2, kernels.room_for(5))
    assert x + dx == pytest.approx(joint.x, rel=1e-6, abs=1e-8)
    assert covariance == pytest.approx(joint.P, rel=1e-6, abs=1e-8)
    assert chi2.sum() == pytest.approx(joint.nis, rel=1e-6)


@examples
@given(seed=SEEDS)
def test_an_update_is_the_information_of_both(seed):
    """000 eq. 3.3.15: P^-1 after = P^-1 before + H' R^-1 H."""
    x, P, e, H, r = problem(seed)
    after = kalman.update(x, P, e, H, np.diag(r))
    information = np.linalg.inv(P) + H.T @ np.diag(1.0 / r) @ H
    assert after.P @ information == pytest.approx(np.eye(5), abs=1e-6)
    assert after.x - x == pytest.approx(after.P @ H.T @ (e / r), rel=1e-6, abs=1e-8)


@examples
@given(seed=SEEDS)
def test_josephs_form_holds_for_any_gain(seed):
    """With a gain that is not the optimal one P - K H P is no covariance of anything; the kernel agrees."""
    _, P, _, H, r = problem(seed, m=1)
    rng = np.random.default_rng(seed + 1)
    K = rng.standard_normal((5, 1))
    after = kalman.joseph(P, H, np.diag(r), K)
    covariance = P.copy()
    kernels.joseph_scalar(covariance, H[0], r[0], K[:, 0])
    assert covariance == pytest.approx(after, rel=1e-8, abs=1e-8)
    best = kalman.update(np.zeros(5), P, np.zeros(1), H, np.diag(r)).P
    assert np.linalg.eigvalsh(after - best)[0] > -1e-8


def test_the_stated_covariance_of_any_gain_is_the_one_of_many_runs():
    rng = np.random.default_rng(3)
    _, P, _, H, r = problem(4, n=3, m=2)
    K = 0.3 * rng.standard_normal((3, 2))
    error = rng.multivariate_normal(np.zeros(3), P, 100_000)
    noise = np.sqrt(r) * rng.standard_normal((100_000, 2))
    after = error - (error @ H.T + noise) @ K.T
    expected = kalman.joseph(P, H, np.diag(r), K)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.cov(after.T) / scale == pytest.approx(expected / scale, abs=0.02)


@examples
@given(seed=SEEDS)
def test_the_compiled_prediction_is_the_one_in_matrices(seed):
    x, P, _, _, _ = problem(seed)
    rng = np.random.default_rng(seed + 1)
    Phi, Q = rng.standard_normal((5, 5)), np.diag(rng.uniform(0.0, 1.0, 5))
    Phi[rng.random((5, 5)) < 0.5] = 0.0
    expected = kalman.predict(x, P, Phi, Q)
    state, covariance = np.empty(5), P.copy()
    pattern = kernels.pattern_of(Phi)
    kernels.propagate_state(x, Phi, pattern, state)
    kernels.propagate_into(covariance, Phi, Q, covariance, pattern, kernels.room_for(5))
    assert state == pytest.approx(expected.x, rel=1e-10, abs=1e-12)
    assert covariance == pytest.approx(expected.P, rel=1e-10, abs=1e-10)
    assert covariance == pytest.approx(covariance.T, rel=1e-12, abs=1e-12)


def test_the_gate_keeps_a_blunder_out():
    x, P, e, H, r = problem(11)
    for gate, accepted in ((np.inf, True), (kalman.gate(3, 0.999), False)):
        outcome = kalman.update(x, P, e + 100.0, H, np.diag(r), gate=gate)
        assert outcome.accepted is accepted
        assert (outcome.x == x).all() is np.bool_(not accepted)
    dx, covariance, chi2 = np.zeros(5), P.copy(), np.empty(3)
    blunder = e + np.array([0.0, 200.0, 0.0])
    assert kernels.update_sequential(dx, covariance, blunder, H, r, kalman.gate(1), chi2, kernels.room_for(5)) == 2
    assert chi2[1] < 0.0 < min(chi2[0], chi2[2])
    kept = kalman.update(x, P, e[[0, 2]], H[[0, 2]], np.diag(r[[0, 2]]))
    assert x + dx == pytest.approx(kept.x)
    assert covariance == pytest.approx(kept.P)


def test_josephs_form_keeps_the_digits_that_the_short_form_loses():
    """Measurements to 1e-6 from a start known to 1e6: P - K H P (000 eq. 3.3.23) against the sum of information."""
    r, rng = 1e-12, np.random.default_rng(0)
    P = np.diag([1e12, 1.0, 1e-4])
    short, information, dx = P.copy(), np.diag(1.0 / np.diag(P)), np.zeros(3)
    for _ in range(300):
        h = rng.standard_normal(3)
        kernels.update_scalar(dx, P, 0.0, h, r, np.inf)
        spread = short @ h
        short = short - np.outer(spread, spread) / (h @ spread + r)
        information = information + np.outer(h, h) / r
    exact = np.linalg.inv(information)
    assert abs(P / exact - 1.0).max() < 1e-6
    assert abs(short / exact - 1.0).max() > 1e-4


# Over a record ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def filtered():
    _, z, x, P = record(1)
    return kalman.filter_record(x, P, Phi=PV.Phi, Q=PV.Q, z=z, H=SEEN, r=np.array([2.25]))


@pytest.fixture(scope="module")
def oracle():
    """The same record through filterpy."""
    _, z, x, P = record(1)
    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.x, kf.P, kf.F, kf.Q, kf.H, kf.R = x[:, None], P.copy(), PV.Phi, PV.Q, SEEN, np.array([[2.25]])
    means, covariances, means_prior, covariances_prior = kf.batch_filter(list(z), update_first=True)
    return kf, means[..., 0], covariances, means_prior[..., 0], covariances_prior


def test_filterpy_filters_the_same(filtered, oracle):
    _, means, covariances, _, _ = oracle
    assert filtered.x == pytest.approx(means, rel=1e-9, abs=1e-9)
    assert pytest.approx(covariances, rel=1e-9, abs=1e-12) == filtered.P


def test_without_the_covariances_of_all_epochs_the_states_are_the_same_and_the_last_stays(filtered):
    _, z, x, P = record(1)
    given = {"Q": PV.Q, "z": z, "H": SEEN, "r": np.array([2.25])}
    short = kalman.filter_record(x, P, Phi=PV.Phi, **given, keep_covariances=False)
    assert (short.x == filtered.x).all()
    assert (short.x_prior == filtered.x_prior).all()
    assert (short.nis == filtered.nis).all()
    assert short.P.shape == short.P_prior.shape == (1, 2, 2)
    assert (short.P[0] == filtered.P[-1]).all()
    assert (short.P_prior[0] == filtered.P_prior[-1]).all()
    with pytest.raises(ShapeError, match="keep_covariances"):
        kalman.smooth(short, PV.Phi)
    # Matrices given for each epoch are those given once.
    every = kalman.filter_record(x, P, Phi=np.tile(PV.Phi, (len(z) - 1, 1, 1)), **given)
    assert (every.x == filtered.x).all()


def test_filterpy_smooths_the_same(filtered, oracle):
    kf, means, covariances, _, _ = oracle
    x, P, _, _ = kf.rts_smoother(means[..., None], covariances)
    ours = kalman.smooth(filtered, PV.Phi)
    assert ours.x == pytest.approx(x[..., 0], rel=1e-8, abs=1e-8)
    assert pytest.approx(P, rel=1e-8, abs=1e-10) == ours.P


def test_the_smoother_is_the_least_squares_solution_of_the_whole_record():
    """All epochs at once, as one weighted least-squares problem."""
    _, z, x, P = record(2, steps=12)
    n = 12
    rows, values = [], []
    root = np.linalg.inv(np.linalg.cholesky(P))
    rows.append(np.hstack([root, np.zeros((2, 2 * (n - 1)))]))
    values.append(root @ x)
    white = np.linalg.inv(np.linalg.cholesky(PV.Q))
    for k in range(n):
        row = np.zeros((1, 2 * n))
        row[0, 2 * k] = 1.0 / 1.5
        rows.append(row)
        values.append(z[k] / 1.5)
        if k + 1 < n:
            row = np.zeros((2, 2 * n))
            row[:, 2 * k : 2 * k + 2], row[:, 2 * k + 2 : 2 * k + 4] = -white @ PV.Phi, white
            rows.append(row)
            values.append(np.zeros(2))
    A, b = np.vstack(rows), np.concatenate(values)
    solution = np.linalg.lstsq(A, b, rcond=None)[0].reshape(n, 2)
    covariance = np.linalg.inv(A.T @ A)
    ran = kalman.filter_record(x, P, Phi=PV.Phi, Q=PV.Q, z=z, H=SEEN, r=np.array([2.25]))
    smooth = kalman.smooth(ran, PV.Phi)
    assert smooth.x == pytest.approx(solution, rel=1e-7, abs=1e-7)
    assert smooth.P[3] == pytest.approx(covariance[6:8, 6:8], rel=1e-7)


def test_the_compiled_record_is_the_steps_in_matrices():
    """Also with gaps, a gate, and matrices that change."""
    truth, z, x, P = record(3)
    z = np.column_stack([z, truth[:, 1:] + 0.7 * np.random.default_rng(4).standard_normal((60, 1))])
    z[10:15, 0] = np.nan
    z[20, 1] += 50.0
    steps = z.shape[0]
    dts = np.linspace(0.2, 0.8, steps - 1)
    Phi = np.array([processes.position_velocity_discrete(0.2, dt).Phi for dt in dts])
    Q = np.array([processes.position_velocity_discrete(0.2, dt).Q for dt in dts])
    H, r, gate = np.eye(2), np.array([2.25, 0.5]), kalman.gate(1)
    ran = kalman.filter_record(x, P, Phi=Phi, Q=Q, z=z, H=H, r=r, gate=gate)
    state, covariance = x, P
    for k in range(steps):
        if k:
            state, covariance = kalman.predict(state, covariance, Phi[k - 1], Q[k - 1])
        assert ran.x_prior[k] == pytest.approx(state, rel=1e-8, abs=1e-8)
        for i in np.flatnonzero(np.isfinite(z[k])):
            row = H[i : i + 1]
            one = kalman.update(state, covariance, z[k, i] - row @ state, row, r[i : i + 1, None], gate=gate)
            state, covariance = one.x, one.P
            assert ran.nis[k, i] == pytest.approx(one.nis, rel=1e-7, abs=1e-9)
            assert ran.rejected[k, i] == (not one.accepted)
        assert ran.x[k] == pytest.approx(state, rel=1e-8, abs=1e-8)
        assert ran.P[k] == pytest.approx(covariance, rel=1e-8, abs=1e-10)
    assert np.isnan(ran.nis[10:15, 0]).all()
    assert ran.rejected[20].tolist() == [False, True]


def test_errors_and_innovations_are_as_large_as_stated():
    """NEES, NIS and the smoother's NEES of 200 runs, each epoch's mean inside its 95 % band about 95 % of the time."""
    nees, nis, smoothed = [], [], []
    for seed in range(200):
        truth, z, x, P = record(1000 + seed, steps=40)
        ran = kalman.filter_record(x, P, Phi=PV.Phi, Q=PV.Q, z=z, H=SEEN, r=np.array([2.25]))
        nees.append(kalman.normalised(ran.x - truth, ran.P))
        nis.append(ran.nis[:, 0])
        back = kalman.smooth(ran, PV.Phi)
        smoothed.append(kalman.normalised(back.x - truth, back.P))
    for squares, freedom in ((nees, 2), (nis, 1), (smoothed, 2)):
        found = kalman.consistency(np.array(squares), freedom)
        assert found.lower < freedom < found.upper
        assert found.inside >= 0.85
        assert found.mean.mean() == pytest.approx(freedom, rel=0.06)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_a_filter_that_is_wrong_about_its_noise_is_found_out(factor):
    nis = []
    for seed in range(100):
        _, z, x, P = record(seed, steps=30)
        nis.append(kalman.filter_record(x, P, Phi=PV.Phi, Q=PV.Q, z=z, H=SEEN, r=np.array([2.25 * factor])).nis[:, 0])
    assert kalman.consistency(np.array(nis), 1).inside < 0.3


def test_smoothing_halves_the_error_of_an_interval_without_measurements():
    errors = []
    for seed in range(30):
        truth, z, x, P = record(seed)
        z[25:35] = np.nan
        ran = kalman.filter_record(x, P, Phi=PV.Phi, Q=PV.Q, z=z, H=SEEN, r=np.array([2.25]))
        back = kalman.smooth(ran, PV.Phi)
        gap = slice(28, 35)
        errors.append([np.std((run.x - truth)[gap, 0]) for run in (ran, back)])
        assert (np.linalg.eigvalsh(ran.P - back.P)[:, 0] > -1e-9).all()
    forward, backward = np.mean(errors, axis=0)
    assert backward < 0.5 * forward


def test_the_steady_state_of_farrenkopf():
    """A bias random walk and an angle random walk seen through an angle sensor: the closed form of Farrenkopf 1978."""
    sigma_v, sigma_u, sigma_n, dt = 0.1, 0.02, 0.5, 1.0
    F, G = np.array([[0.0, -1.0], [0.0, 0.0]]), np.diag([-1.0, 1.0])
    gyro = processes.Process(F, G, np.diag([sigma_v**2, sigma_u**2])).discrete(dt)
    z = np.zeros((4000, 1))
    ran = kalman.filter_record(
        np.zeros(2), np.diag([1.0, 1.0]), Phi=gyro.Phi, Q=gyro.Q, z=z, H=SEEN, r=np.array([sigma_n**2])
    )
    S_u, S_v = sigma_u * dt**1.5 / sigma_n, sigma_v * dt**0.5 / sigma_n
    gamma = np.sqrt(4.0 + S_v**2 + S_u**2 / 12.0)
    zeta = 0.25 * (2.0 * gamma + S_u + np.sqrt((2.0 * gamma + S_u) ** 2 - 16.0))
    assert ran.P[-1][0, 0] == pytest.approx(sigma_n**2 * (1.0 - 1.0 / zeta**2), rel=1e-6)


# Nonlinear ----------------------------------------------------------------------------------------------------


class LinearModel:
    """The PV model in the clothes of a nonlinear one."""

    def step(self, x, k):
        del k
        return Step(PV.Phi @ x, PV.Phi, PV.Q)

    def observe(self, x, k):
        del k
        return Observation(SEEN @ x, SEEN, np.array([[2.25]]))


def test_a_linear_model_is_filtered_alike_by_all_three(filtered):
    _, z, x, P = record(1)
    reference = np.array([np.linalg.matrix_power(PV.Phi, k) @ np.array([3.0, -1.0]) for k in range(z.shape[0])])
    for run in (
        kalman.extended(LinearModel(), x, P, z),
        kalman.linearised(LinearModel(), reference, x, P, z),
    ):
        assert run.x == pytest.approx(filtered.x, rel=1e-8, abs=1e-8)
        assert pytest.approx(filtered.P, rel=1e-8, abs=1e-10) == run.P
        assert run.nis == pytest.approx(filtered.nis, rel=1e-7, abs=1e-9)


def pendulum(steps: int):
    """A pendulum whose horizontal deflection is measured; the angle may be large."""

    def observation(x, k):
        del k
        return Observation(np.array([np.sin(x[0])]), np.array([[np.cos(x[0]), 0.0]]), np.array([[0.02**2]]))

    return ContinuousModel(
        t=0.05 * np.arange(steps),
        f=lambda x, t: np.array([x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1] + 0.0 * t]),
        F=lambda x, t: np.array([[0.0, 1.0], [-9.81 * np.cos(x[0]) + 0.0 * t, -0.1]]),
        diffusion=np.diag([0.0, 0.02]),
        observation=observation,
    )


def swing(model, start, rng):
    """Noisy truth and measurements."""
    truth = [start]
    for k in range(model.t.size - 1):
        step = model.step(truth[-1], k)
        truth.append(rng.multivariate_normal(step.x, step.Q))
    truth = np.array(truth)
    return truth, np.sin(truth[:, :1]) + 0.02 * rng.standard_normal((truth.shape[0], 1))


def test_the_extended_filter_tells_its_error():
    model, P = pendulum(80), np.diag([0.05**2, 0.1**2])
    squares, nis = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        start = np.array([0.6, 0.0])
        truth, z = swing(model, rng.multivariate_normal(start, P), rng)
        run = kalman.extended(model, start, P, z)
        squares.append(kalman.normalised(run.x - truth, run.P))
        nis.append(run.nis[:, 0])
    assert kalman.consistency(np.array(squares), 2).inside >= 0.85
    assert np.mean(nis) == pytest.approx(1.0, rel=0.1)


def test_the_extended_filter_beats_one_linearised_far_from_the_truth():
    model, P = pendulum(100), np.diag([0.5**2, 0.5**2])
    reference = [np.array([1.2, 0.0])]
    for k in range(99):
        reference.append(model.step(reference[-1], k).x)
    errors = []
    for seed in range(10):
        truth, z = swing(model, np.array([0.5, 0.3]), np.random.default_rng(seed))
        runs = (
            kalman.extended(model, reference[0], P, z),
            kalman.linearised(model, np.array(reference), reference[0], P, z),
        )
        errors.append([np.sqrt(np.mean((run.x - truth)[20:, 0] ** 2)) for run in runs])
    extended, linearised = np.median(errors, axis=0)
    assert extended < 0.03
    assert linearised > 3.0 * extended


def test_near_the_reference_both_agree():
    model, P = pendulum(60), np.diag([0.01**2, 0.01**2])
    start = np.array([0.3, 0.0])
    reference = [start]
    for k in range(59):
        reference.append(model.step(reference[-1], k).x)
    _, z = swing(model, start, np.random.default_rng(1))
    extended = kalman.extended(model, start, P, z)
    linearised = kalman.linearised(model, np.array(reference), start, P, z)
    assert abs(extended.x - linearised.x)[:, 0].max() < 0.01


def test_epochs_without_measurement_and_blunders_are_left_out():
    model = pendulum(30)
    _, z = swing(model, np.array([0.3, 0.0]), np.random.default_rng(2))
    z[10], z[20] = np.nan, 5.0
    run = kalman.extended(model, np.array([0.3, 0.0]), np.diag([0.01, 0.01]), z, gate=kalman.gate(1))
    assert np.isnan(run.nis[10, 0])
    assert np.flatnonzero(run.rejected[:, 0]).tolist() == [20]
    assert (run.x[20] == run.x_prior[20]).all()


def test_numeric_derivatives():
    model = pendulum(2)
    x = np.array([0.7, -0.4])
    assert kalman.jacobian(lambda s: model.f(s, 0.0), x) == pytest.approx(model.F(x, 0.0), abs=1e-8)
    step = model.step(x, 0)
    assert kalman.jacobian(lambda s: model.step(s, 0).x, x) == pytest.approx(step.Phi, abs=2e-3)


# Bands and refusals -------------------------------------------------------------------------------------------


def test_bands_of_chi_square():
    assert kalman.gate(1, 0.95) == pytest.approx(1.96**2, rel=1e-3)
    lower, upper = kalman.mean_band(1, 50)
    assert (lower * 50, upper * 50) == pytest.approx((32.357, 71.420), abs=1e-3)


@examples
@given(freedom=st.integers(1, 15), runs=st.integers(1, 500))
def test_bands_hold_the_mean(freedom, runs):
    lower, upper = kalman.mean_band(freedom, runs)
    assert lower < freedom < upper


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (lambda: kalman.update(np.zeros(2), -np.eye(2), np.zeros(1), SEEN, np.eye(1) * 0.5), CovarianceError),
        (lambda: kalman.decorrelated(np.zeros(2), np.eye(2), -np.eye(2)), CovarianceError),
        (lambda: kalman.gate(0), RangeError),
        (lambda: kalman.gate(1, 1.0), RangeError),
        (lambda: kalman.consistency(np.zeros(3), 1), ShapeError),
        (lambda: kalman.normalised(np.zeros(3), np.eye(2)), ShapeError),
        (lambda: kalman.extended(LinearModel(), np.zeros(2), np.eye(2), np.zeros(3)), ShapeError),
        (
            lambda: kalman.linearised(LinearModel(), np.zeros((2, 2)), np.zeros(2), np.eye(2), np.zeros((3, 1))),
            ShapeError,
        ),
        (lambda: run_with(z=np.zeros(3)), ShapeError),
        (lambda: run_with(H=np.zeros((3, 3))), ShapeError),
        (lambda: run_with(r=np.array([0.0])), RangeError),
    ],
)
def test_what_has_no_meaning_is_refused(wrong, error):
    with pytest.raises(error):
        wrong()


def run_with(**changed):
    _, z, x, P = record(1, steps=5)
    return kalman.filter_record(x, P, **{"Phi": PV.Phi, "Q": PV.Q, "z": z, "H": SEEN, "r": np.array([2.25])} | changed)
