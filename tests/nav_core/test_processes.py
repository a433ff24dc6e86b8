"""Transition matrices four ways, discrete noise, correlated noise; and where the print differs."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.common import van_loan_discretization as filterpy_van_loan
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from nav_core import processes
from nav_core.errors import RangeError, ShapeError
from nav_core.processes import Process, ShapingFilter

examples = settings(deadline=None, max_examples=50)
STEPS = st.floats(0.01, 2.0)
DENSITIES = st.floats(1e-3, 10.0)
SPRING = processes.spring(2.0, 0.6, 8.0, density=3.0)


def matrices(n: int):
    return arrays(np.float64, (n, n), elements=st.floats(-1.5, 1.5))


def integrated(F, dt, columns):
    """Columns carried through x' = F x by an integrator that knows nothing of matrix exponentials."""
    n = columns.shape[0]

    def rate(t, flat):
        return ((F(t) if callable(F) else F) @ flat.reshape(n, -1)).ravel()

    return solve_ivp(rate, (0.0, dt), columns.ravel(), rtol=1e-11, atol=1e-12).y[:, -1].reshape(n, -1)


def test_the_transition_matrix_solves_the_equation():
    assert processes.transition(SPRING.F, 0.7) == pytest.approx(integrated(SPRING.F, 0.7, np.eye(2)), abs=1e-9)


@examples
@given(dt=STEPS, density=DENSITIES)
def test_pv_and_pva_in_closed_form_are_van_loan(dt, density):
    for closed, process in (
        (processes.position_velocity_discrete(density, dt), processes.position_velocity(density)),
        (
            processes.position_velocity_acceleration_discrete(density, dt),
            processes.position_velocity_acceleration(density),
        ),
    ):
        exact = process.discrete(dt)
        assert closed.Phi == pytest.approx(exact.Phi, abs=1e-12)
        assert pytest.approx(exact.Q, rel=1e-9, abs=1e-12) == closed.Q


def test_filterpy_has_the_same_noise():
    pva = processes.position_velocity_acceleration_discrete(0.3, 0.5)
    assert pytest.approx(Q_continuous_white_noise(3, 0.5, spectral_density=0.3), rel=1e-12) == pva.Q
    Phi, Q = filterpy_van_loan(SPRING.F, SPRING.G * np.sqrt(SPRING.Q[0, 0]), 0.2)
    ours = SPRING.discrete(0.2)
    assert ours.Phi == pytest.approx(Phi, rel=1e-12)
    assert pytest.approx(Q, rel=1e-12) == ours.Q


def test_the_printed_pva_matrix_lacks_the_half():
    """003: a constant acceleration must carry a point at rest by a t²/2."""
    printed = np.array([[1.0, 2.0, 4.0], [0.0, 1.0, 2.0], [0.0, 0.0, 1.0]])
    exact = integrated(np.eye(3, k=1), 2.0, np.eye(3))
    assert processes.position_velocity_acceleration_discrete(1.0, 2.0).Phi == pytest.approx(exact)
    assert abs(printed - exact).max() == pytest.approx(2.0)


def test_the_pv_noise_has_two_components():
    """003 prints three for a state of two."""
    assert processes.position_velocity(1.0).G.shape == (2, 1)


@examples
@given(dt=STEPS, sigma=st.floats(0.1, 5.0), tau=st.floats(0.2, 100.0))
def test_gauss_markov_in_closed_form_is_van_loan_and_keeps_its_variance(dt, sigma, tau):
    closed, exact = processes.gauss_markov_discrete(sigma, tau, dt), processes.gauss_markov(sigma, tau).discrete(dt)
    assert closed.Phi == pytest.approx(exact.Phi, rel=1e-9)
    assert pytest.approx(exact.Q, rel=1e-6) == closed.Q
    assert closed.Phi * sigma**2 * closed.Phi + closed.Q == pytest.approx(sigma**2)


def test_gauss_markov_is_exponentially_correlated_in_a_simulation():
    rng = np.random.default_rng(1)
    sigma, tau, dt = 2.0, 1.0, 0.1
    discrete = processes.gauss_markov_discrete(sigma, tau, dt)
    path = processes.sample_path(discrete, sigma * rng.standard_normal((20_000, 1)), 20, rng)[:, :, 0]
    measured = np.mean(path[5:] * path[5], axis=1)
    expected = processes.gauss_markov_covariance(sigma, tau, dt * np.arange(16))
    assert measured == pytest.approx(expected, abs=5.0 * sigma**2 / np.sqrt(20_000))


def test_a_random_walk_grows_without_end():
    rng = np.random.default_rng(2)
    path = processes.sample_path(processes.random_walk(0.5).discrete(2.0), np.zeros((20_000, 1)), 10, rng)
    assert np.var(path[:, :, 0], axis=1) == pytest.approx(np.arange(11.0), rel=0.05)


def test_simulated_singular_noise_has_the_stated_covariance():
    rng = np.random.default_rng(3)
    discrete = processes.position_velocity_acceleration_discrete(2.0, 0.4)
    ends = processes.sample_path(discrete, np.zeros((40_000, 3)), 1, rng)[1]
    spread = np.sqrt(np.diag(discrete.Q))
    assert np.cov(ends.T) / np.outer(spread, spread) == pytest.approx(discrete.Q / np.outer(spread, spread), abs=0.03)


@examples
@given(matrix=matrices(3), dt=STEPS)
def test_the_series_converges_to_the_exponential(matrix, dt):
    assert processes.transition_series(matrix, dt, 60) == pytest.approx(
        processes.transition(matrix, dt), rel=1e-8, abs=1e-8
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_error_of_the_series_falls_with_its_order(order):
    def error(dt):
        return abs(processes.transition_series(SPRING.F, dt, order) - processes.transition(SPRING.F, dt)).max()

    assert np.log2(error(0.02) / error(0.01)) == pytest.approx(order + 1, abs=0.1)


def test_the_series_ends_by_itself_for_integrators():
    """000 eq. 3.6.7: powers of t over factorials."""
    for order, process in ((1, processes.position_velocity(1.0)), (2, processes.position_velocity_acceleration(1.0))):
        assert processes.transition_series(process.F, 3.0, order) == pytest.approx(expm(3.0 * process.F))
    Phi = processes.transition_series(processes.integrators(4, 1.0).F, 2.0, 3)
    assert Phi[0] == pytest.approx([1.0, 2.0, 2.0, 8.0 / 6.0])


LAPLACE = {
    "under-damped": SPRING.F,
    "critically damped": processes.spring(1.0, 4.0, 4.0).F,
    "over-damped": processes.spring(1.0, 5.0, 4.0).F,
    "nearly critical": processes.spring(1.0, 4.0 + 1e-9, 4.0).F,
    "pva": processes.position_velocity_acceleration(1.0).F,
    "gauss-markov drives pv": processes.augment(
        processes.position_velocity(1.0), np.eye(2), driving=ShapingFilter(processes.gauss_markov(1.0, 3.0), np.eye(1))
    ).process.F,
    "rotation": np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.1], [-0.2, 0.1, 0.0]]),
}


@pytest.mark.parametrize("name", LAPLACE)
def test_the_inverse_laplace_transform_is_the_exponential(name):
    for dt in (0.01, 0.3, 2.0):
        assert processes.transition_laplace(LAPLACE[name], dt) == pytest.approx(
            processes.transition(LAPLACE[name], dt), rel=1e-6, abs=1e-8
        )


def test_the_resonance_of_the_spring():
    """000 eqs. 3.5.4-3.5.8."""
    eigenvalues = np.linalg.eigvals(SPRING.F)
    assert eigenvalues.real == pytest.approx(-0.6 / 4.0)
    assert abs(eigenvalues.imag) == pytest.approx(np.sqrt(4.0 * 2.0 * 8.0 - 0.36) / 4.0)


def test_force_pushes_the_way_it_points():
    """000 eq. 3.4.4 prints -w/m, 3.4.6 +w/m: a mass at rest must follow the force."""
    pushed = processes.evolve(SPRING.F, SPRING.G, np.zeros(2), np.ones((1, 1)), 0.1)
    assert (pushed[1] > 0.0).all()
    printed = processes.evolve(SPRING.F, -SPRING.G, np.zeros(2), np.ones((1, 1)), 0.1)
    assert (printed[1] < 0.0).all()


@examples
@given(a=STEPS, b=STEPS)
def test_transitions_compose_and_invert(a, b):
    """000 section 3.6.3, properties 1-3."""
    F = SPRING.F
    assert processes.transition(F, 0.0) == pytest.approx(np.eye(2))
    assert processes.transition(F, b) @ processes.transition(F, a) == pytest.approx(processes.transition(F, a + b))
    assert processes.transition(F, -a) @ processes.transition(F, a) == pytest.approx(np.eye(2), abs=1e-12)


def swinging(t):
    """Dynamics that do not commute with themselves at another time."""
    return np.array([[0.0, 1.0], [-4.0 * t, -0.2]])


def test_the_later_transition_stands_on_the_left():
    """003 prints Phi(t1,t2) Phi(t2,t3), and the exponential of the integral, which also wants commuting F."""
    dt, count = 0.005, 400
    middles = dt * (np.arange(count) + 0.5)
    F = np.array([swinging(t) for t in middles])
    truth = integrated(swinging, dt * count, np.eye(2))
    assert processes.transition_varying(F, dt) == pytest.approx(truth, abs=1e-4)
    reverse = processes.transition_varying(F[::-1], dt)
    assert abs(reverse - truth).max() > 0.1
    assert abs(expm(F.sum(axis=0) * dt) - truth).max() > 0.1


def test_halving_the_step_of_varying_dynamics_quarters_the_error():
    truth = integrated(swinging, 2.0, np.eye(2))

    def error(count):
        dt = 2.0 / count
        F = np.array([swinging(dt * (k + 0.5)) for k in range(count)])
        return abs(processes.transition_varying(F, dt) - truth).max()

    assert np.log2(error(50) / error(100)) == pytest.approx(2.0, abs=0.1)


def test_the_derivative_with_respect_to_the_start():
    """000 section 3.6.3, property 5: d Phi(tau, t)/dt = -Phi F(t); the print has + and F inverse."""
    F, step = SPRING.F, 1e-5
    slope = (processes.transition(F, 1.0 - step) - processes.transition(F, 1.0 + step)) / (2.0 * step)
    Phi = processes.transition(F, 1.0)
    assert slope == pytest.approx(-Phi @ F, abs=1e-6)
    assert abs(slope - Phi @ np.linalg.inv(F)).max() > 1.0


def test_a_constant_force_leads_to_its_equilibrium():
    """The forced response: 003's exp(-F (t - tau)) would diverge."""
    states = processes.evolve(SPRING.F, SPRING.G, np.zeros(2), np.full((400, 1), 4.0), 0.2)
    assert states[-1] == pytest.approx([4.0 / 8.0, 0.0], abs=1e-4)
    # exp(-F(t - tau)) integrates to the effect of time run backwards.
    printed = processes.evolve(-SPRING.F, SPRING.G, np.zeros(2), np.full((400, 1), 4.0), 0.2)
    assert abs(printed[-1]).max() > 100.0


def test_the_input_acts_until_the_end_of_the_step():
    """000 eq. 3.6.26 with its upper end t_k+1."""
    pv = processes.position_velocity(1.0)
    assert processes.input_matrix(pv.F, pv.G, 3.0) == pytest.approx(np.array([[4.5], [3.0]]))


def test_two_half_steps_add_the_noise_of_one():
    half, whole = SPRING.discrete(0.4), SPRING.discrete(0.8)
    assert half.Phi @ half.Q @ half.Phi.T + half.Q == pytest.approx(whole.Q, rel=1e-10)


def test_short_steps_have_first_order_noise():
    def error(dt):
        return abs(SPRING.discrete(dt).Q - processes.first_order_noise(SPRING.diffusion, dt)).max()

    assert np.log2(error(2e-3) / error(1e-3)) == pytest.approx(2.0, abs=0.05)


def test_van_loan_noise_is_the_integral():
    """000 eq. 3.6.28 by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    dt = 0.9
    total = np.zeros((2, 2))
    for node, weight in zip(nodes, weights, strict=True):
        Phi = expm(SPRING.F * (0.5 * dt * (node + 1.0)))
        total += 0.5 * dt * weight * Phi @ SPRING.diffusion @ Phi.T
    assert pytest.approx(total, rel=1e-10) == SPRING.discrete(dt).Q


# Augmentation -------------------------------------------------------------------------------------------------


def test_correlated_noise_becomes_a_state():
    pv = processes.position_velocity(0.1)
    wind = ShapingFilter(processes.gauss_markov(0.5, 20.0), np.eye(1))
    bias = ShapingFilter(processes.gauss_markov(3.0, 60.0), np.eye(1))
    whole = processes.augment(pv, np.array([[1.0, 0.0]]), driving=wind, sensor=bias)
    assert whole.H.tolist() == [[1.0, 0.0, 0.0, 1.0]]
    expected = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, -1 / 20.0, 0], [0, 0, 0, -1 / 60.0]])
    assert pytest.approx(expected) == whole.process.F
    assert whole.process.diffusion == pytest.approx(np.diag([0.0, 0.1, 2 * 0.25 / 20.0, 2 * 9.0 / 60.0]))


def test_correlated_noise_may_enter_elsewhere():
    drift = ShapingFilter(processes.random_walk(1.0), np.array([[2.0]]))
    whole = processes.augment(processes.position_velocity(1.0), np.eye(2), driving=drift, D=np.array([[1.0], [0.0]]))
    assert whole.process.F[0].tolist() == [0.0, 1.0, 2.0]


def test_the_augmented_system_is_the_system_with_its_noise_simulated_apart():
    """000 eq. 3.10.25 prints H where the filters' transition matrices belong: its variance would be another."""
    rng = np.random.default_rng(5)
    tau, sigma, dt, steps, runs = 2.0, 1.5, 0.05, 60, 4000
    plain = Process(np.array([[-0.4]]), np.eye(1), np.array([[0.2]]))
    noise = processes.gauss_markov(sigma, tau)
    whole = processes.augment(plain, np.eye(1), driving=ShapingFilter(noise, np.eye(1))).process.discrete(dt)
    x, correlated = np.zeros(runs), sigma * rng.standard_normal(runs)
    white, shaped = plain.discrete(dt), processes.gauss_markov_discrete(sigma, tau, dt)
    for _ in range(steps):
        following = shaped.Phi[0, 0] * correlated + np.sqrt(shaped.Q[0, 0]) * rng.standard_normal(runs)
        held = processes.input_matrix(plain.F, plain.G, dt)[0, 0] * 0.5 * (correlated + following)
        x = white.Phi[0, 0] * x + held + np.sqrt(white.Q[0, 0]) * rng.standard_normal(runs)
        correlated = following
    P = np.diag([0.0, sigma**2])
    printed = P.copy()
    wrong = np.array([[whole.Phi[0, 0], whole.Phi[0, 1]], [0.0, 1.0]])
    for _ in range(steps):
        P = whole.Phi @ P @ whole.Phi.T + whole.Q
        printed = wrong @ printed @ wrong.T + whole.Q
    assert np.var(x) == pytest.approx(P[0, 0], rel=0.08)
    assert P[1, 1] == pytest.approx(sigma**2)
    assert printed[0, 0] > 1.5 * P[0, 0]


def test_stacked_axes_stay_independent():
    three = processes.stack(*[processes.gauss_markov(s, 5.0) for s in (1.0, 2.0, 3.0)])
    assert pytest.approx(-np.eye(3) / 5.0) == three.F
    assert np.diag(three.diffusion) == pytest.approx(2.0 / 5.0 * np.array([1.0, 4.0, 9.0]))


# Refusals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: processes.transition(np.zeros((2, 3)), 1.0),
        lambda: processes.transition_varying(np.zeros((2, 2)), 1.0),
        lambda: processes.van_loan(np.zeros((2, 2)), np.zeros((1, 1)), 1.0),
        lambda: processes.input_matrix(np.zeros((2, 2)), np.zeros((3, 1)), 1.0),
        lambda: Process(np.zeros((2, 2)), np.zeros((3, 1)), np.eye(1)),
        lambda: Process(np.zeros((2, 2)), np.zeros((2, 1)), np.eye(2)),
        lambda: processes.augment(SPRING, np.eye(3)),
        lambda: processes.augment(SPRING, np.eye(2), driving=ShapingFilter(SPRING, np.eye(2))),
        lambda: processes.augment(SPRING, np.eye(2), sensor=ShapingFilter(SPRING, np.ones((1, 2)))),
    ],
)
def test_shapes_that_do_not_fit_are_refused(wrong):
    with pytest.raises(ShapeError):
        wrong()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: processes.transition_series(np.eye(2), 1.0, 0),
        lambda: processes.integrators(0, 1.0),
        lambda: processes.gauss_markov(1.0, 0.0),
        lambda: processes.gauss_markov_discrete(1.0, -1.0, 0.1),
        lambda: processes.gauss_markov_covariance(1.0, 0.0, np.zeros(2)),
        lambda: processes.spring(0.0, 1.0, 1.0),
    ],
)
def test_values_without_meaning_are_refused(wrong):
    with pytest.raises(RangeError):
        wrong()
