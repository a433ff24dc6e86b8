"""Mechanisations: kernels against plain numpy, frames against each other and the peer, and against exact motion."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from nav_core import earth
from nav_core.errors import RangeError, ShapeError
from nav_core.rotation import angle_between, euler_to_matrix, matrix_to_rotvec, skew, wrap
from nav_core.simulate import Scenario, simulate
from nav_core.simulate.globe import on_the_globe
from nav_core.strapdown import (
    Increments,
    Navigation,
    Track,
    cartesian_kernels,
    from_integrals,
    from_rates,
    kernels,
    mechanise,
    wander_kernels,
)
from tests.nav_core import globe_motion
from tests.oracles import strapdown as peer
from tests.oracles import transform

FRAMES = ("ned", "neu", "w", "e", "i")

HORIZONTAL, SPEED, ANGLE = 0.01, 1e-5, 1e-7
"""What frames may differ by: m, m/s, rad."""


# --- frames and peer against each other ------------------------------------------------------------------------


def apart(one: Track, other: Track) -> tuple[float, float, float, float]:
    """Largest differences: horizontal and vertical position (m), velocity (m/s), attitude (rad; every 20th moment)."""
    meridian, normal = earth.radii(one.lat)
    north = (one.lat - other.lat) * (meridian + one.height)
    east = wrap(one.lon - other.lon) * (normal + one.height) * np.cos(one.lat)
    turn = matrix_to_rotvec(one.R_tb[::-20] @ np.swapaxes(other.R_tb[::-20], 1, 2))
    return (
        float(np.hypot(north, east).max()),
        float(np.abs(one.height - other.height).max()),
        float(np.abs(one.velocity - other.velocity).max()),
        float(np.linalg.norm(turn, axis=1).max()),
    )


def peers_track(start: Navigation, increments: Increments, *, hold_height: bool) -> Track:
    """The same increments through python-ins."""
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    place = [np.degrees(start.lat), np.degrees(start.lon), start.height]
    pva = pd.Series([*place, *start.velocity, *transform.mat_to_rph(start.R_tb)], index=names)
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = np.column_stack((increments.periods, increments.rotation, increments.velocity))
    integrator = peer.Integrator(pva, with_altitude=not hold_height)
    found = integrator.integrate(pd.DataFrame(table, index=increments.t[1:], columns=columns))
    return Track(
        increments.t,
        np.radians(found.lat.to_numpy()),
        np.radians(found.lon.to_numpy()),
        found.alt.to_numpy(),
        found[["VN", "VE", "VD"]].to_numpy(),
        transform.mat_from_rph(found[["roll", "pitch", "heading"]].to_numpy()),
    )


def simulated(duration, height, *, level):
    _, truth = simulate(Scenario(route="urban", duration=duration, accel_rate=100.0).faultless(), seed=1)
    drive = on_the_globe(truth, (np.radians(45.07), np.radians(7.69), height), level=level)
    begin = drive.velocity[0], drive.R_tv[0]
    start = Navigation(float(drive.lat[0]), float(drive.lon[0]), float(drive.height[0]), *begin)
    return drive, start, from_rates(drive.t, drive.w_v, drive.f_v)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")
def test_an_hour_of_driving_is_the_same_in_all_frames_and_for_the_peer():
    _, start, increments = simulated(3600.0, 240.0, level=True)
    assert increments.periods.size == 359_999
    reference = mechanise(start, increments, frame="ned", hold_height=True)
    others = {frame: mechanise(start, increments, frame=frame, hold_height=True) for frame in FRAMES[1:]}
    others["peer"] = peers_track(start, increments, hold_height=True)
    assert np.ptp(reference.lat) * earth.SEMI_MAJOR > 2000.0
    for name, track in others.items():
        horizontal, vertical, speed, angle = apart(reference, track)
        print(f"{name}: {horizontal:.1e} m, {speed:.1e} m/s, {angle:.1e} rad")
        assert horizontal < HORIZONTAL
        assert vertical < 1e-8
        assert speed < SPEED
        assert angle < ANGLE


@pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")
def test_a_minute_with_a_free_vertical_channel():
    # From the ellipsoid, where the peer's linear gravity agrees with the second-order one.
    _, start, increments = simulated(60.0, 0.0, level=False)
    reference = mechanise(start, increments, frame="ned")
    others = {frame: mechanise(start, increments, frame=frame) for frame in FRAMES[1:]}
    others["peer"] = peers_track(start, increments, hold_height=False)
    assert np.ptp(reference.height) > 3.0
    for name, track in others.items():
        horizontal, vertical, speed, angle = apart(reference, track)
        print(f"{name}: {horizontal:.1e} m, {vertical:.1e} m, {speed:.1e} m/s, {angle:.1e} rad")
        assert max(horizontal, vertical) < HORIZONTAL
        assert speed < SPEED
        assert angle < ANGLE


def test_the_simulated_drive_on_the_globe_is_navigated_back():
    # From rates at 100 Hz, whose change within a period is taken as linear.
    drive, start, increments = simulated(60.0, 240.0, level=False)
    track = mechanise(start, increments)
    truth = Track(drive.t, drive.lat, drive.lon, drive.height, drive.velocity, drive.R_tv)
    horizontal, vertical, speed, angle = apart(track, truth)
    assert max(horizontal, vertical) < 2e-3
    assert speed < 2e-4
    assert angle < 1e-5


# --- against exact motion --------------------------------------------------------------------------------------


def error_after_five_seconds(frame, count):
    t = np.linspace(0.0, 5.0, count + 1)
    track = mechanise(globe_motion.state(0.0), from_integrals(t, *globe_motion.integrals(t)), frame=frame)
    truth = globe_motion.state(5.0)
    place = earth.geodetic_to_ecef(truth.lat, truth.lon, truth.height)
    return (
        np.linalg.norm(track.r_e[-1] - place),
        np.linalg.norm(track.velocity[-1] - truth.velocity),
        angle_between(track.R_tb[-1], truth.R_tb),
    )


@pytest.mark.parametrize("frame", FRAMES)
def test_errors_against_the_exact_motion_shrink_with_the_order_of_the_method(frame):
    errors = np.array([error_after_five_seconds(frame, count) for count in (250, 500, 1000)])
    orders = np.log2(errors[:-1] / errors[1:])
    # Position is a trapezoid over velocity; coning and sculling are those of two readings.
    assert np.all(orders[:, 0] > 1.85)
    assert np.all(orders[:, 1] > 2.9)
    assert np.all(orders[:, 2] > 2.9)
    assert errors[1] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert errors[1, 0] < 1e-4
    assert errors[1, 1] < 1e-5
    assert errors[1, 2] < 1e-7


@pytest.mark.parametrize("frame", FRAMES)
def test_rest_stays_rest(frame):
    lat, height, R = np.radians(-33.0), 500.0, euler_to_matrix(0.2, -0.1, 2.0)
    t = np.linspace(0.0, 100.0, 1001)
    w = R.T @ earth.earth_rate(lat)
    f = R.T @ np.array([0.0, 0.0, -earth.gravity(lat, height)])
    increments = from_rates(t, np.tile(w, (t.size, 1)), np.tile(f, (t.size, 1)))
    track = mechanise(Navigation(lat, 3.0, height, np.zeros(3), R), increments, frame=frame, hold_height=True)
    n = t.size
    stood = Track(t, np.full(n, lat), np.full(n, 3.0), np.full(n, height), np.zeros((n, 3)), np.tile(R, (n, 1, 1)))
    horizontal, vertical, speed, angle = apart(track, stood)
    assert horizontal < 1e-6
    assert vertical < 1e-8
    assert speed < 1e-8
    assert angle < 1e-11


# --- the poles -------------------------------------------------------------------------------------------------


def over_the_pole(side, count=1000):
    """Level flight at 190 m/s along two opposite meridians, in closed form by the angle from the pole.

    Moments, positions, velocities and attitudes in e, rates and forces, and the place of the start.
    """
    t, turning, height, lon = np.linspace(0.0, 200.0, count + 1), 3e-5, 1000.0, 0.6
    angle = turning * (t - 100.0)
    bulge = 1.0 - earth.ECCENTRICITY2 * np.cos(angle) ** 2
    meridian = earth.SEMI_MAJOR * (1.0 - earth.ECCENTRICITY2) / bulge**1.5
    speed = turning * (meridian + height)
    gain = -3.0 * turning**2 * meridian * earth.ECCENTRICITY2 * np.sin(angle) * np.cos(angle) / bulge
    lat = side * (np.pi / 2.0 - np.abs(angle))
    r = earth.geodetic_to_ecef(lat, np.where(angle < 0.0, lon, lon - np.pi), height)

    sine, cosine = np.sin(angle), np.cos(angle)
    forward = np.stack((-cosine * np.cos(lon), -cosine * np.sin(lon), -side * sine), axis=-1)
    down = np.stack((sine * np.cos(lon), sine * np.sin(lon), -side * cosine), axis=-1)
    R_eb = np.stack((forward, np.cross(down, forward), down), axis=-1)
    v = speed[:, None] * forward
    w = np.array([0.0, -turning, 0.0]) + earth.RATE * R_eb[:, 2, :]
    f = np.einsum("nji,nj->ni", R_eb, 2.0 * np.cross([0.0, 0.0, earth.RATE], v))
    f[:, 0] += gain
    f[:, 2] += speed * turning - earth.gravity(lat, height)
    return t, r, v, R_eb, w, f, (float(lat[0]), lon, height)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pole_is_crossed_in_wander_azimuth(side):
    t, r, v, R_eb, w, f, place = over_the_pole(side)
    start = Navigation(*place, earth.tangent_axes(*place[:2]).T @ v[0], earth.tangent_axes(*place[:2]).T @ R_eb[0])
    increments = from_rates(t, w, f)
    tracks = {frame: mechanise(start, increments, frame=frame, hold_height=True) for frame in ("w", "e", "i")}
    assert np.abs(tracks["w"].lat).max() > np.radians(89.9999)
    for track in tracks.values():
        assert np.linalg.norm(track.r_e - r, axis=1).max() < 1e-5
        assert np.linalg.norm(track.v_e - v, axis=1).max() < 1e-7
        assert angle_between(track.R_eb[-1], R_eb[-1]) < 1e-10
    with pytest.raises(RangeError):
        mechanise(start, increments, frame="ned", hold_height=True)


# --- kernels against plain numpy -------------------------------------------------------------------------------


def reference_local(place, v, C, rotation, velocity, T, hold):
    """`kernels.step_local` in matrices and with the array functions of `nav_core.earth`."""
    lat, _, height = place
    meridian, _ = earth.radii(lat)
    middle_lat, middle_height = lat + 0.5 * T * v[0] / (meridian + height), height - 0.5 * T * v[2]
    spin, gravity = earth.earth_rate(middle_lat), np.array([0.0, 0.0, earth.gravity(middle_lat, middle_height)])

    def change(speed):
        transport = earth.transport_rate(middle_lat, middle_height, speed)
        gain = (np.eye(3) - 0.5 * T * skew(spin + transport)) @ C @ velocity
        return gain + T * (gravity - np.cross(2.0 * spin + transport, speed))

    free = np.array([1.0, 1.0, 0.0 if hold else 1.0])
    after = free * (v + change(free * (v + 0.5 * change(v))))
    mean = 0.5 * (v + after)
    meridian, normal = earth.radii(middle_lat)
    rates = [mean[0] / (meridian + middle_height), mean[1] / ((normal + middle_height) * np.cos(middle_lat)), -mean[2]]
    turning = spin + earth.transport_rate(middle_lat, middle_height, mean)
    return place + T * np.array(rates), after, expm(-T * skew(turning)) @ C @ expm(skew(rotation))


def reference_cartesian(r, v, C, rotation, velocity, T, frame_rate):
    """`cartesian_kernels.step_cartesian` in matrices."""
    spin, frame = earth.RATE * np.array([0.0, 0.0, 1.0]), frame_rate * np.array([0.0, 0.0, 1.0])
    middle = r + 0.5 * T * (v + np.cross(spin - frame, r))
    lat, lon, height = earth.ecef_to_geodetic(middle)
    gravity = earth.gravity(lat, height) * earth.tangent_axes(lat, lon)[:, 2]
    force = (np.eye(3) - 0.5 * T * skew(frame)) @ C @ velocity + T * gravity
    mean = v + 0.5 * (force - T * np.cross(spin + frame, v))
    after = v + force - T * np.cross(spin + frame, mean)
    place = r + 0.5 * T * (v + after) + T * np.cross(spin - frame, middle)
    return place, after, expm(-T * skew(frame)) @ C @ expm(skew(rotation))


vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
compiled = settings(deadline=None, max_examples=40)


@compiled
@given(st.floats(-1.5, 1.5), vectors, vectors, vectors, vectors, st.floats(1e-3, 0.1), st.booleans())
def test_the_local_step_agrees_with_matrices(lat, v, angles, rotation, velocity, T, hold):
    place, v, C = np.array([lat, 0.5, 300.0]), 100.0 * v, euler_to_matrix(*angles)
    expected = reference_local(place, v, C, rotation, velocity, T, hold)
    state = place.copy(), v.copy(), C.copy()
    kernels.step_local(*state, rotation, velocity, T, hold)
    assert np.allclose(state[0], expected[0], rtol=1e-13, atol=1e-13)
    assert np.allclose(state[1], expected[1], atol=1e-11)
    assert np.allclose(state[2], expected[2], atol=1e-13)
    # The same in the mirror, from north, east, up and back.
    mirror = np.diag([1.0, 1.0, -1.0])
    raised = place.copy(), mirror @ v, mirror @ C
    kernels.step_up(*raised, rotation, velocity, T, hold)
    assert np.allclose(mirror @ raised[1], state[1], atol=1e-12)
    assert np.allclose(mirror @ raised[2], state[2], atol=1e-14)
    assert np.array_equal(raised[0], state[0])


@compiled
@given(st.floats(-1.5, 1.5), vectors, vectors, vectors, vectors, st.floats(1e-3, 0.1), st.booleans())
def test_the_cartesian_step_agrees_with_matrices(lat, v, angles, rotation, velocity, T, inertial):
    r, v, C = earth.geodetic_to_ecef(lat, 0.5, 300.0), 100.0 * v, euler_to_matrix(*angles)
    frame_rate = 0.0 if inertial else earth.RATE
    expected = reference_cartesian(r, v, C, rotation, velocity, T, frame_rate)
    state = r.copy(), v.copy(), C.copy()
    cartesian_kernels.step_cartesian(*state, rotation, velocity, T, frame_rate)
    assert np.allclose(state[0], expected[0], atol=1e-8)
    assert np.allclose(state[1], expected[1], atol=1e-11)
    assert np.allclose(state[2], expected[2], atol=1e-13)


@compiled
@given(st.floats(-1.5, 1.5), vectors, st.floats(-3.0, 3.0))
def test_the_wander_transport_rate_is_the_local_one_without_its_vertical_part(lat, v, azimuth):
    # Seen from axes turned by any azimuth; also the Earth's axis the step works with.
    R_tw = euler_to_matrix(0.0, 0.0, azimuth)
    R_ew = earth.tangent_axes(lat, 0.3) @ R_tw
    local = earth.transport_rate(lat, 200.0, R_tw @ (100.0 * v))
    found = wander_kernels.wander_transport(tuple(R_ew[2]), 200.0, tuple(100.0 * v))
    assert np.allclose(found, R_tw.T @ (local * [1.0, 1.0, 0.0]), atol=1e-16)
    assert found[2] == 0.0


# --- the frames of the text ------------------------------------------------------------------------------------


def test_the_printed_2525_turns_the_wrong_matrix():
    # C_w^e grows by [w_ew]x on its right; the printed C_e^w does not.
    R_ew, rate = earth.tangent_axes(1.2, 0.6), 1e-3 * np.array([2.0, -1.0, 0.0])
    state = R_ew.copy()
    kernels.turn(state, (0.0, 0.0, 0.0), tuple(rate))
    assert np.allclose(state, R_ew @ expm(skew(rate)), atol=1e-15)
    printed = (R_ew.T @ expm(skew(rate))).T
    assert angle_between(printed, state) > 1e-3


def test_a_track_tells_the_same_in_e():
    t = np.linspace(0.0, 1.0, 11)
    track = mechanise(globe_motion.state(0.0), from_integrals(t, *globe_motion.integrals(t)))
    assert np.allclose(track.v_e[3], track.R_et[3] @ track.velocity[3])
    assert np.allclose(track.R_eb[3], track.R_et[3] @ track.R_tb[3])
    assert np.allclose(np.diff(track.r_e, axis=0) / 0.1, 0.5 * (track.v_e[1:] + track.v_e[:-1]), atol=1e-3)


def test_longitude_wraps_at_the_date_line():
    start = Navigation(0.3, np.pi - 1e-7, 0.0, np.array([0.0, 30.0, 0.0]), np.eye(3))
    t = np.linspace(0.0, 1.0, 11)
    rest = np.tile([0.0, 0.0, -9.8], (11, 1))
    for frame in FRAMES:
        track = mechanise(start, from_rates(t, np.zeros((11, 3)), rest), frame=frame, hold_height=True)
        assert track.lon[0] > 3.0
        assert track.lon[-1] < -3.0


def test_a_start_needs_its_shapes():
    with pytest.raises(ShapeError):
        Navigation(0.1, 0.2, 0.0, np.zeros(2), np.eye(3))
