"""Growth of the position error (000 eq. 6.1.3) against what navigation with such errors does."""

from dataclasses import fields, replace

import numpy as np
import pytest

from nav_core import earth
from nav_core.errors import RangeError
from nav_core.rotation import euler_to_matrix
from nav_core.strapdown import Navigation, from_rates, mechanise
from nav_core.strapdown.drift import Drift, ResidualErrors, position_drift

T = 60.0
LAT, HEIGHT = np.radians(45.0), 200.0
GRAVITY = float(earth.gravity(LAT, HEIGHT))


def eastward(residual: ResidualErrors, *, force=0.0, ahead=0.0):
    """Error to the east after a minute, of a body that faces north and is pushed east and ahead, m/s², from rest."""
    t = np.linspace(0.0, T, 601)

    def navigated(residual: ResidualErrors):
        w = np.array([residual.gyro_bias, 0.0, 0.0])
        f = np.array([ahead, force * (1.0 + residual.accel_scale) + residual.accel_bias, -GRAVITY])
        w = w + earth.earth_rate(LAT)
        lon = residual.position / ((earth.radii(LAT)[1] + HEIGHT) * np.cos(LAT))
        R = euler_to_matrix(residual.tilt, 0.0, residual.heading)
        start = Navigation(LAT, float(lon), HEIGHT, np.array([0.0, residual.velocity, 0.0]), R)
        return mechanise(start, from_rates(t, np.tile(w, (t.size, 1)), np.tile(f, (t.size, 1))), hold_height=True)

    truth, found = navigated(ResidualErrors()), navigated(residual)
    _, normal = earth.radii(LAT)
    return (found.lon[-1] - truth.lon[-1]) * (normal + HEIGHT) * np.cos(LAT)


@pytest.mark.parametrize(
    ("cause", "size", "push"),
    [
        ("position", 3.0, {}),
        ("velocity", 0.2, {}),
        ("accel_bias", 0.02, {}),
        ("gyro_bias", -1e-4, {}),
        ("tilt", -2e-3, {}),
        ("heading", 0.01, {"ahead": 0.5}),
        ("accel_scale", 0.01, {"force": 0.5}),
    ],
)
def test_each_term_is_what_navigation_drifts(cause, size, push):
    residual = ResidualErrors(**{cause: size})
    motion = {"speed": 0.5 * push.get("ahead", 0.0) * T, "force": push.get("force", 0.0)}
    drift = position_drift(np.array([T]), residual, gravity=GRAVITY, **motion)
    assert drift.total[0] == pytest.approx(eastward(residual, **push), rel=0.02)
    assert getattr(drift, cause)[0] == drift.total[0]


def test_the_last_term_bounds_what_a_gyros_scale_error_does_to_a_curve():
    t, speed, turned, scale = np.linspace(0.0, T, 6001), 15.0, 0.2, 0.01
    course = turned * t / T
    error = np.stack((np.cos(course * (1.0 + scale)) - np.cos(course), np.sin(course * (1.0 + scale)) - np.sin(course)))
    found = np.linalg.norm(speed * np.trapezoid(error, t))
    bound = position_drift(np.array([T]), ResidualErrors(gyro_scale=scale), speed=speed, turned=turned).total[0]
    # The heading's error grows to its final size; the printed term has it from the start.
    assert found == pytest.approx(0.5 * bound, rel=0.02)


def test_terms_add_and_combine():
    t = np.linspace(0.0, 100.0, 11)
    sizes = {item.name: 0.1 * (k + 1) for k, item in enumerate(fields(ResidualErrors))}
    every = ResidualErrors(**sizes)
    drift = position_drift(t, every, speed=10.0, force=0.3, turned=0.5)
    alone = [
        position_drift(t, replace(ResidualErrors(), **{name: size}), speed=10.0, force=0.3, turned=0.5).total
        for name, size in sizes.items()
    ]
    assert isinstance(drift, Drift)
    assert np.allclose(drift.terms, np.stack(alone, axis=-1))
    assert np.allclose(drift.total, np.sum(alone, axis=0))
    assert np.allclose(drift.rms, np.sqrt(np.sum(np.square(alone), axis=0)))
    with pytest.raises(RangeError):
        position_drift(np.array([-1.0]), every)


def test_gyros_err_with_the_cube_and_accelerometers_with_the_square_of_time():
    t = np.array([10.0, 20.0])
    gyro = position_drift(t, ResidualErrors(gyro_bias=1e-3)).total
    accel = position_drift(t, ResidualErrors(accel_bias=1e-3)).total
    assert gyro[1] == pytest.approx(8.0 * gyro[0])
    assert accel[1] == pytest.approx(4.0 * accel[0])
