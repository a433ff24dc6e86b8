"""Coning and sculling: the kernel against plain numpy, exact motions, and the peer."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import NotFiniteError, OrderError, RangeError, ShapeError, TooLittleDataError
from nav_core.rotation import angle_between, rotvec_to_matrix
from nav_core.strapdown import Increments, from_integrals, from_rates
from nav_core.strapdown.increments import gather
from tests.oracles import strapdown as peer

compiled = settings(deadline=None, max_examples=40)
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def noise(count, seed=1):
    rng = np.random.default_rng(seed)
    return 0.02 * rng.normal(size=(count, 3)), 0.1 * rng.normal(size=(count, 3))


@pytest.mark.parametrize("per_interval", [1, 2, 5])
def test_the_recursion_is_a_double_sum(per_interval):
    # Savage's sums written out: over pairs of readings of an interval, and over neighbours.
    angle, thrust = noise(40)
    angles, thrusts, coning, sculling = gather(angle, thrust, per_interval)
    before_angle, before_thrust = np.vstack([angle[:1], angle[:-1]]), np.vstack([thrust[:1], thrust[:-1]])
    for m in range(40 // per_interval):
        own = range(m * per_interval, (m + 1) * per_interval)
        cone = sum(np.cross(before_angle[k], angle[k]) / 12.0 for k in own)
        cone = cone + sum(np.cross(angle[j], angle[k]) / 2.0 for k in own for j in own if j < k)
        scull = sum((np.cross(before_angle[k], thrust[k]) + np.cross(before_thrust[k], angle[k])) / 12.0 for k in own)
        scull = scull + sum(
            (np.cross(angle[j], thrust[k]) + np.cross(thrust[j], angle[k])) / 2.0 for k in own for j in own if j < k
        )
        assert np.allclose(angles[m], angle[list(own)].sum(axis=0), atol=1e-16)
        assert np.allclose(thrusts[m], thrust[list(own)].sum(axis=0), atol=1e-15)
        assert np.allclose(coning[m], cone, atol=1e-17)
        assert np.allclose(sculling[m], scull, atol=1e-16)


def test_the_peer_makes_the_same_increments_of_rates_and_of_readings():
    t = np.cumsum(np.random.default_rng(3).uniform(0.008, 0.012, 101))
    w, f = 0.5 * noise(101)[0], noise(101)[1] - np.array([0.0, 0.0, 9.8])
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    table = pd.DataFrame(np.hstack((w, f)), index=t, columns=columns)
    theirs = peer.compute_increments_from_imu(table, "rate")
    ours = from_rates(t, w, f)
    assert np.allclose(ours.periods, theirs.dt, atol=1e-15)
    assert np.allclose(ours.rotation, theirs[["theta_x", "theta_y", "theta_z"]], atol=1e-16)
    # The peer leaves out what is of third order in the angle.
    assert np.allclose(ours.velocity, theirs[["dv_x", "dv_y", "dv_z"]], atol=1e-8)

    theirs = peer.compute_increments_from_imu(table, "increment")
    ours = from_integrals(t, w[1:], f[1:])
    assert np.allclose(ours.rotation[1:], theirs[["theta_x", "theta_y", "theta_z"]][1:], atol=1e-16)
    bound = 2.0 * np.linalg.norm(w[1:], axis=1)[:, None] ** 2 * 9.9
    assert np.all(np.abs(ours.velocity - theirs[["dv_x", "dv_y", "dv_z"]])[1:] <= bound[1:])


@compiled
@given(vectors, vectors, st.floats(1e-6, 0.3))
def test_increments_are_exact_for_constant_rate_and_force(w, f, period):
    t = np.array([0.0, period])
    for found in (
        from_rates(t, np.tile(w, (2, 1)), np.tile(f, (2, 1))),
        from_integrals(t, period * w[None], period * f[None]),
    ):
        nodes = period * 0.5 * (1.0 + np.polynomial.legendre.leggauss(12)[0])
        weights = period * 0.5 * np.polynomial.legendre.leggauss(12)[1]
        turned = Rotation.from_rotvec(np.outer(nodes, w)).apply(f)
        assert np.allclose(found.rotation[0], period * w, atol=1e-15)
        assert np.allclose(found.velocity[0], weights @ turned, atol=1e-13)


def coning_motion(t, half_angle=0.05, frequency=20.0):
    """Attitude of pure coning, whose rotation axis circles in the plane x, y; the rate by differences of it."""
    axis = np.stack((np.cos(frequency * t), np.sin(frequency * t), np.zeros_like(t)), axis=-1)
    attitude = Rotation.from_rotvec(half_angle * axis)
    rate = np.stack(
        (
            -frequency * np.sin(half_angle) * np.sin(frequency * t),
            frequency * np.sin(half_angle) * np.cos(frequency * t),
            np.full_like(t, -frequency * (1.0 - np.cos(half_angle))),
        ),
        axis=-1,
    )
    integral = np.stack(
        (
            np.sin(half_angle) * np.cos(frequency * t),
            np.sin(half_angle) * np.sin(frequency * t),
            -frequency * (1.0 - np.cos(half_angle)) * t,
        ),
        axis=-1,
    )
    return attitude, rate, integral


def coning_drift(count, per_interval=1, *, corrected=True):
    t = np.linspace(0.0, 2.0, count + 1)
    attitude, _, integral = coning_motion(t)
    angle = np.diff(integral, axis=0)
    rotation = from_integrals(t, angle, np.zeros_like(angle), per_interval=per_interval).rotation
    turned = attitude[0]
    for step in rotation if corrected else angle:
        turned = turned * Rotation.from_rotvec(step)
    return angle_between(turned.as_matrix(), attitude[-1].as_matrix())


def test_the_correction_takes_the_drift_out_of_coning():
    # 2 s of 3.2 Hz with 2.9° of half angle at 100 Hz: a plain sum of angles drifts by 0.0017 rad.
    assert coning_drift(200, corrected=False) > 1.5e-4
    assert coning_drift(200) < 0.02 * coning_drift(200, corrected=False)
    # Gathered over four readings it is still the fast ones that count.
    assert coning_drift(800, per_interval=4) < 0.02 * coning_drift(200, corrected=False)


def test_sculling_makes_no_velocity_of_swaying():
    # Rocking about x in step with surging along y gains velocity along z; sums of readings alone lose it.
    t = np.linspace(0.0, 2.0, 201)
    rocking, surging, frequency = 0.05, 3.0, 15.0
    angle = np.diff(rocking * np.sin(frequency * t))[:, None] * [1.0, 0.0, 0.0]
    thrust = np.diff(surging / frequency * -np.cos(frequency * t))[:, None] * [0.0, 1.0, 0.0]
    found = from_integrals(t, angle, thrust)
    exact, plain, gained = np.zeros(3), np.zeros(3), np.zeros(3)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    attitude = Rotation.identity()
    for k in range(200):
        inner = 0.5 * (t[k] + t[k + 1]) + 0.005 * nodes
        at = Rotation.from_rotvec(np.outer(rocking * np.sin(frequency * inner), [1.0, 0.0, 0.0]))
        exact += 0.005 * weights @ at.apply(np.outer(surging * np.sin(frequency * inner), [0.0, 1.0, 0.0]))
        gained += attitude.apply(found.velocity[k])
        plain += attitude.apply(thrust[k])
        attitude = attitude * Rotation.from_rotvec(found.rotation[k])
    assert exact[2] == pytest.approx(rocking * surging * (1.0 - np.sin(60.0) / 60.0), rel=1e-2)
    assert np.abs(gained - exact).max() < 1e-2 * np.abs(plain - exact).max()


def test_rates_with_linear_change_are_second_order():
    t = np.linspace(0.0, 0.4, 9)
    w, f = np.stack((1.0 + t, -2.0 * t, 0.5 + 0.0 * t), axis=-1), np.zeros((9, 3))
    turned = np.eye(3)
    for step in from_rates(t, w, f).rotation:
        turned = turned @ rotvec_to_matrix(step)
    fine = np.linspace(0.0, 0.4, 4001)
    middle = 0.5 * (fine[1:] + fine[:-1])
    rates = np.stack((1.0 + middle, -2.0 * middle, 0.5 + 0.0 * middle), axis=-1)
    exact = np.eye(3)
    for rate in rates:
        exact = exact @ rotvec_to_matrix(1e-4 * rate)
    assert angle_between(turned, exact) < 2e-7


def test_what_makes_no_increments_is_refused():
    w = np.zeros((3, 3))
    with pytest.raises(ShapeError):
        from_rates(np.arange(4.0), w, w)
    with pytest.raises(OrderError):
        from_rates(np.array([0.0, 2.0, 1.0]), w, w)
    with pytest.raises(TooLittleDataError):
        from_rates(np.zeros(1), w[:1], w[:1])
    with pytest.raises(ShapeError):
        from_rates(np.zeros((3, 1)), w, w)
    with pytest.raises(ShapeError):
        from_integrals(np.arange(4.0), w, w, per_interval=2)
    with pytest.raises(RangeError):
        from_integrals(np.arange(4.0), w, w, per_interval=0)
    with pytest.raises(ShapeError):
        Increments(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3)))
    with pytest.raises(NotFiniteError, match="f is not finite at index 1"):
        from_rates(np.arange(3.0), w, np.where(np.arange(3)[:, None] == 1, np.nan, w))
    with pytest.raises(NotFiniteError, match="rotation"):
        Increments(np.arange(4.0), np.full((3, 3), np.inf), w)
