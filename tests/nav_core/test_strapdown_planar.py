"""Navigation in two dimensions: exact motions, the plane against the meridian, and the table's signs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nav_core.errors import RangeError, ShapeError
from nav_core.strapdown.planar import PlanarStart, around, navigate_meridian, navigate_plane

RADIUS, G = 6.37e6, 9.81


def swinging(t):
    """Force and rate of a body that swings while it is pushed."""
    f_b = np.stack((1.0 + 0.5 * np.sin(t), 9.0 + np.cos(0.7 * t)), axis=-1)
    return f_b, 0.3 * np.cos(0.5 * t)


def plane_exactly(t, gravity):
    def rates(now, state):
        f_b, w_y = swinging(np.array(now))
        c, s = np.cos(state[0]), np.sin(state[0])
        return [
            float(w_y),
            f_b[0] * c + f_b[1] * s + gravity[0],
            -f_b[0] * s + f_b[1] * c + gravity[1],
            state[1],
            state[2],
        ]

    return solve_ivp(rates, (t[0], t[-1]), np.zeros(5), t_eval=t, rtol=1e-11, atol=1e-11).y


def test_the_plane_is_second_order():
    errors = []
    for count in (400, 800):
        t = np.linspace(0.0, 8.0, count + 1)
        track = navigate_plane(*swinging(t), t[1], gravity=(0.1, -9.8))
        exact = plane_exactly(t, (0.1, -9.8))
        errors.append(
            [
                np.abs(found - truth).max()
                for found, truth in zip((track.theta, track.v_x, track.x), exact[[0, 1, 3]], strict=True)
            ]
        )
        assert np.abs(track.z - exact[4]).max() < 1e-2
    assert np.log2(np.array(errors[0]) / errors[1]) == pytest.approx([2.0, 2.0, 2.0], abs=0.05)


def meridian_exactly(t, first):
    def rates(now, state):
        theta, v_x, v_z, _, z = state
        f_b, w_y = swinging(np.array(now))
        c, s, r = np.cos(theta), np.sin(theta), RADIUS + z
        a_x, a_z = f_b[0] * c + f_b[1] * s, -f_b[0] * s + f_b[1] * c
        return [w_y - v_x / r, a_x - v_x * v_z / r, a_z - G + v_x**2 / r, v_x * RADIUS / r, v_z]

    return solve_ivp(rates, (t[0], t[-1]), first, t_eval=t, rtol=1e-11, atol=1e-11).y.T


def test_the_meridians_kernel_agrees_with_plain_equations():
    first = np.array([0.1, 250.0, 3.0, 10.0, 2000.0])
    errors = []
    for count in (400, 800):
        t = np.linspace(0.0, 8.0, count + 1)
        f_b, w_y = swinging(t)
        errors.append(np.abs(around(first, f_b, w_y, t[1], G, RADIUS) - meridian_exactly(t, first)).max(axis=0))
    assert np.all(errors[1] < [1e-5, 1e-3, 1e-3, 5e-3, 5e-3])
    assert np.all(np.log2(errors[0] / errors[1]) > 1.9)


def test_a_circular_orbit_closes():
    height = 1000.0
    speed = np.sqrt(G * (RADIUS + height))
    start = PlanarStart(v_x=speed, z=height)
    track = navigate_meridian(np.zeros((6001, 2)), np.zeros(6001), 0.1, gravity=G, radius=RADIUS, start=start)
    assert np.abs(track.z - height).max() < 0.01
    assert np.abs(track.v_x - speed).max() < 1e-5
    # Not turning in space, the body turns backwards against the horizon, once an orbit.
    assert track.theta[-1] == pytest.approx(-speed / (RADIUS + height) * 600.0, rel=1e-9)
    assert track.x[-1] == pytest.approx(speed * 600.0 * RADIUS / (RADIUS + height), rel=1e-9)


def test_the_printed_vertical_equation_fails_at_rest_or_in_orbit():
    # Table 2.2.2 has v_z' = f_z + g - v_x² / r.  With g > 0 a body at rest flies off, with g < 0 an orbit falls.
    orbit = np.sqrt(G * RADIUS)
    for g in (G, -G):
        at_rest, in_orbit = G + g, g - orbit**2 / RADIUS
        assert max(abs(at_rest), abs(in_orbit)) == pytest.approx(2.0 * G)
    ours = [
        navigate_meridian(
            np.tile([0.0, f], (101, 1)), np.full(101, w), 0.1, gravity=G, radius=RADIUS, start=PlanarStart(v_x=v)
        ).v_z[-1]
        for f, w, v in ((G, 0.0, 0.0), (0.0, orbit / RADIUS, orbit))
    ]
    assert np.allclose(ours, 0.0, atol=1e-6)


def test_the_meridian_is_the_plane_seen_along_the_ground():
    # The same climb in a plane at rest, whose gravity points to the middle of the Earth.
    t = np.linspace(0.0, 300.0, 6001)
    f_b, w_y = np.stack((0.5 + 0.1 * np.sin(0.05 * t), 9.85 + 0.0 * t), axis=-1), 1e-4 * np.cos(0.02 * t)
    start = PlanarStart(theta=0.01, v_x=200.0, v_z=40.0, z=500.0)
    track = navigate_meridian(f_b, w_y, t[1], gravity=G, radius=RADIUS, start=start)
    assert track.z[-1] - 500.0 > 3000.0

    def rates(now, state):
        theta, v_x, v_z, x, z = state
        f = np.array([np.interp(now, t, f_b[:, 0]), 9.85])
        r = np.hypot(x, z)
        c, s = np.cos(theta), np.sin(theta)
        return [
            np.interp(now, t, w_y),
            f[0] * c + f[1] * s - G * x / r,
            -f[0] * s + f[1] * c - G * z / r,
            v_x,
            v_z,
        ]

    plane = solve_ivp(
        rates, (0.0, 300.0), [0.01, 200.0, 40.0, 0.0, RADIUS + 500.0], rtol=1e-11, atol=1e-9, max_step=1.0
    )
    theta, v_x, v_z, x, z = plane.y[:, -1]
    arc = np.arctan2(x, z)
    assert track.x[-1] == pytest.approx(RADIUS * arc, abs=0.02)
    assert track.z[-1] == pytest.approx(np.hypot(x, z) - RADIUS, abs=0.02)
    assert track.theta[-1] == pytest.approx(theta - arc, abs=1e-8)
    assert track.v_x[-1] == pytest.approx(v_x * np.cos(arc) - v_z * np.sin(arc), abs=2e-4)
    # The printed + v_x v_z / r would gain 2 v_x v_z / r of speed on the way up: 0.4 m/s by the end.
    assert 2.0 * np.sum(t[1] * track.v_x * track.v_z / (RADIUS + track.z)) > 0.3
    # The table's x' = v_x is distance flown, which at height is longer than its foot on the ground.
    flown = np.sum(0.5 * t[1] * (track.v_x[1:] + track.v_x[:-1]))
    assert flown - RADIUS * arc > 10.0


def test_what_is_not_planar_is_refused():
    with pytest.raises(ShapeError):
        navigate_plane(np.zeros((3, 3)), np.zeros(3), 0.1, gravity=(0.0, -G))
    with pytest.raises(ShapeError):
        navigate_plane(np.zeros((3, 2)), np.zeros((3, 1)), 0.1, gravity=(0.0, -G))
    with pytest.raises(RangeError):
        navigate_plane(np.zeros((3, 2)), np.zeros(3), 0.0, gravity=(0.0, -G))
    with pytest.raises(RangeError):
        navigate_meridian(np.zeros((3, 2)), np.zeros(3), 0.1, gravity=G, radius=0.0)
    assert navigate_meridian(np.zeros((1, 2)), np.zeros(1), 0.1, gravity=G, radius=RADIUS).x.shape == (1,)
