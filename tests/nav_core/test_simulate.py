"""The simulator's instruments: mounting, sampling, noise, lag, outages, and reproducibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import OrderError, RangeError, ShapeError
from nav_core.rotation import angle_between, thesis_to_matrix, wrap
from nav_core.simulate import Impact, Move, Scenario, random_rotation, simulate

G = 9.80665
MG = 1e-3 * G
LEVEL = {"slope": 0.0, "crown": 0.0, "bank": 0.0}
MOUNT = thesis_to_matrix(np.radians(20.0), np.radians(-35.0), np.radians(110.0))


def test_at_rest_and_level_the_box_feels_gravity_upside_down() -> None:
    drive, truth = simulate(Scenario(route="static", duration=5.0, R_va=MOUNT, **LEVEL).faultless(), seed=0)
    assert np.allclose(truth.f_v, [0.0, 0.0, -G], atol=1e-12)
    assert np.allclose(drive.inertial.f, MOUNT.T @ [0.0, 0.0, -G], atol=1e-12)


def test_forces_and_rates_are_seen_in_the_box_frame() -> None:
    scenario = Scenario(duration=30.0, R_va=MOUNT, with_gyro=True).faultless()
    drive, truth = simulate(scenario, seed=1)
    assert drive.inertial.w is not None
    assert np.allclose(drive.inertial.f @ MOUNT.T, truth.f_v, atol=1e-12)
    assert np.allclose(drive.inertial.w @ MOUNT.T, truth.w_v, atol=1e-12)
    assert np.array_equal(truth.R_va, MOUNT)


def test_every_seed_draws_another_mounting() -> None:
    mountings = [simulate(Scenario(duration=1.0), seed=seed)[1].R_va for seed in range(5)]
    for k, one in enumerate(mountings):
        assert np.allclose(one @ one.T, np.eye(3))
        assert np.linalg.det(one) == pytest.approx(1.0)
        assert all(angle_between(one, other) > 0.01 for other in mountings[:k])


def test_random_rotations_are_uniform() -> None:
    rng = np.random.default_rng(2)
    drawn = np.array([random_rotation(rng) for _ in range(4000)])
    # Every entry has mean 0 and variance 1/3; the trace's mean is 0 and its variance 1.
    assert np.abs(drawn.mean(axis=0)).max() < 4.0 * np.sqrt(1.0 / 3.0 / 4000)
    assert np.allclose(drawn.var(axis=0), 1.0 / 3.0, atol=0.02)
    assert np.trace(drawn, axis1=1, axis2=2).var() == pytest.approx(1.0, rel=0.1)


def test_moves_turn_the_box() -> None:
    turn = (0.1, -0.2, 0.5)
    moves = (Move(t=10.0, turn=turn), Move(t=20.0, R_va=np.eye(3)))
    scenario = Scenario(duration=30.0, R_va=MOUNT, moves=moves, with_gyro=True).faultless()
    drive, truth = simulate(scenario, seed=3)
    turned = MOUNT @ Rotation.from_rotvec(turn).as_matrix()
    assert [since for since, _ in truth.mountings] == [-np.inf, 10.0, 20.0]
    assert angle_between(MOUNT, turned) == pytest.approx(np.linalg.norm(turn))
    for begin, end, R_va in ((0.0, 10.0, MOUNT), (10.0, 20.0, turned), (20.0, 30.0, np.eye(3))):
        during = (truth.t >= begin) & (truth.t < end)
        assert np.allclose(drive.inertial.f[during] @ R_va.T, truth.f_v[during], atol=1e-12)


def test_quantisation_and_clipping_come_last() -> None:
    scenario = Scenario(duration=20.0, accel_full_scale=0.5 * G)
    drive, _ = simulate(scenario, seed=4)
    steps = drive.inertial.f / scenario.accel_resolution
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert np.abs(drive.inertial.f).max() == pytest.approx(0.5 * G)
    assert (np.abs(drive.inertial.f) == 0.5 * G).sum() > 100


def test_sensor_noise_has_the_sizes_asked_for() -> None:
    bare = Scenario(route="static", duration=60.0, **LEVEL, vibration_idle=0.0, with_gyro=True)
    drive, truth = simulate(replace(bare, accel_resolution=0.0), seed=5)
    assert drive.inertial.w is not None
    error = drive.inertial.f - truth.R_va.T @ [0.0, 0.0, -G] - truth.accel_bias
    assert np.abs(error.mean(axis=0)).max() < 5.0 * 8.0 * MG / np.sqrt(12_000)
    assert np.allclose(error.std(axis=0), 8.0 * MG, rtol=0.03)
    assert np.abs(np.corrcoef(error[:-1, 0], error[1:, 0])[0, 1]) < 0.04
    assert np.allclose(drive.inertial.w.mean(axis=0), truth.gyro_bias, atol=1e-4)
    assert np.allclose(drive.inertial.w.std(axis=0), np.radians(0.15), rtol=0.03)
    biases = [simulate(Scenario(route="static", duration=1.0), seed=seed)[1].accel_bias for seed in range(100)]
    assert np.std(biases) == pytest.approx(5.0 * MG, rel=0.15)


def test_the_bias_drifts_over_the_drive() -> None:
    scenario = replace(
        Scenario(route="static", duration=100.0, R_va=np.eye(3), **LEVEL).faultless(), accel_bias_drift=0.3
    )
    drive, truth = simulate(scenario, seed=6)
    assert np.abs(truth.accel_bias_drift).max() > 0.05
    assert np.allclose(drive.inertial.f[-1] - drive.inertial.f[0], truth.accel_bias_drift, atol=1e-3)


def test_vibration_grows_with_speed_and_keeps_to_its_bands() -> None:
    quiet = Scenario(route="highway", duration=120.0, R_va=np.eye(3)).faultless()
    shaken = replace(quiet, vibration=0.12 * G, vibration_low=0.04 * G, vibration_idle=0.004 * G)
    drive, truth = simulate(shaken, seed=7)
    noise = drive.inertial.f - truth.f_v
    assert truth.v.min() > shaken.vibration_speed  # so both bands are at full level
    assert np.allclose(noise.std(axis=0), np.hypot(0.12, 0.04) * G, rtol=0.1)
    power = np.abs(np.fft.rfft(noise * np.hanning(len(noise))[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(noise), 1.0 / 200.0)
    total = power.sum(axis=0)
    high = power[(frequency > 7.5) & (frequency < 25.5)].sum(axis=0) / total
    low = power[(frequency > 0.9) & (frequency < 3.1)].sum(axis=0) / total
    assert np.allclose(high, 0.9, atol=0.05)
    assert np.allclose(high + low, 1.0, atol=0.01)
    standing, truth = simulate(replace(shaken, route="static", **LEVEL), seed=7)
    assert np.allclose((standing.inertial.f - truth.f_v).std(axis=0), 0.004 * G, rtol=0.1)


def test_fixes_lag_speed_and_course_apart() -> None:
    scenario = replace(Scenario(duration=120.0).faultless(), speed_lag=0.45, course_lag=0.2)
    drive, truth = simulate(scenario, seed=8)
    gnss = drive.gnss
    late = gnss.t > 0.5
    north, east = truth.velocity[:, 0], truth.velocity[:, 1]
    speed = np.interp(gnss.t - 0.45, truth.t, np.hypot(north, east))
    assert np.abs(gnss.speed - speed)[late].max() < 1e-3
    course = np.interp(gnss.t - 0.2, truth.t, np.unwrap(np.arctan2(east, north)))
    moving = late & (np.interp(gnss.t - 0.2, truth.t, truth.v) > 1.0)
    assert np.abs(wrap(gnss.course - course))[moving].max() < 1e-3
    assert gnss.utc is not None
    assert np.allclose(gnss.utc - scenario.start_utc, gnss.t - 0.45, atol=1e-3)
    assert (truth.speed_lag, truth.course_lag) == (0.45, 0.2)


def test_a_receiver_may_smooth_what_it_says() -> None:
    plain = replace(Scenario(duration=120.0).faultless(), speed_lag=0.3, course_lag=0.3)
    drive, truth = simulate(replace(plain, gnss_smoothing=0.8), seed=8)
    gnss = drive.gnss
    # An oracle apart from the simulator's own filter: the integral over the past, weighed by its age.
    age = np.arange(0.0, 8.0, 0.005)
    weight = np.exp(-age / 0.8) / np.exp(-age / 0.8).sum()
    late = gnss.t > 12.0
    when = gnss.t[late, None] - 0.3 - age
    north, east = (np.interp(when, truth.t, truth.velocity[:, axis]) @ weight for axis in (0, 1))
    assert np.abs(gnss.speed[late] - np.hypot(north, east)).max() < 0.02
    moving = gnss.speed[late] > 2.0
    assert np.abs(wrap(gnss.course[late] - np.arctan2(east, north)))[moving].max() < 0.005
    assert np.array_equal(drive.inertial.f, simulate(plain, seed=8)[0].inertial.f)


def test_drawn_lags_cover_their_range() -> None:
    truths = [simulate(Scenario(route="static", duration=1.0), seed=seed)[1] for seed in range(60)]
    lags = np.array([(truth.speed_lag, truth.course_lag) for truth in truths])
    assert lags.min() >= 0.0
    assert lags.max() <= 0.6
    assert np.ptp(lags, axis=0).min() > 0.5
    assert abs(np.corrcoef(lags.T)[0, 1]) < 0.4


def test_receiver_noise_has_the_sizes_asked_for() -> None:
    scenario = Scenario(route="highway", duration=3000.0, accel_rate=10.0, speed_lag=0.0, course_lag=0.0)
    noisy, _ = simulate(scenario, seed=9)
    clean, _ = simulate(replace(scenario.faultless(), accel_rate=10.0), seed=9)
    speed = noisy.gnss.speed - clean.gnss.speed
    assert speed.std() == pytest.approx(0.08, rel=0.05)
    # Half of the variance keeps exp(-1/16) over the 0.25 s between fixes.
    assert np.corrcoef(speed[:-1], speed[1:])[0, 1] == pytest.approx(0.5 * np.exp(-1.0 / 16.0), abs=0.06)
    across = wrap(noisy.gnss.course - clean.gnss.course) * clean.gnss.speed
    assert across.std() == pytest.approx(0.08, rel=0.05)
    height = noisy.gnss.alt - clean.gnss.alt
    assert height.std() == pytest.approx(3.0, rel=0.12)
    assert np.corrcoef(height[:-16], height[16:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.12)
    north = (noisy.gnss.lat - clean.gnss.lat) * 6.367e6
    assert north.std() == pytest.approx(2.0, rel=0.12)


def test_the_course_is_random_at_standstill() -> None:
    drive, _ = simulate(Scenario(route="static", duration=200.0), seed=10)
    course = drive.gnss.course
    assert course.min() < 0.1
    assert course.max() > 2.0 * np.pi - 0.1
    assert np.abs(np.exp(1j * course).mean()) < 0.15
    assert drive.gnss.speed.max() < 0.5
    assert drive.gnss.speed.min() == 0.0


def test_outages_and_frozen_fixes() -> None:
    scenario = Scenario(duration=60.0, outages=((10.0, 20.0), (50.0, 55.0)), frozen=((30.0, 33.0),))
    drive, _ = simulate(scenario, seed=11)
    free, _ = simulate(replace(scenario, outages=(), frozen=()), seed=11)
    gnss = drive.gnss
    out = ((gnss.t >= 10.0) & (gnss.t < 20.0)) | ((gnss.t >= 50.0) & (gnss.t < 55.0))
    assert np.array_equal(~gnss.fix, out)
    for name in ("lat", "lon", "alt", "speed", "course", "utc"):
        assert np.array_equal(np.isnan(getattr(gnss, name)), out)
    stuck = (gnss.t >= 30.0) & (gnss.t < 33.0)
    assert len(set(gnss.speed[stuck])) == 1
    assert gnss.speed[stuck][0] == gnss.speed[gnss.t < 30.0][-1]
    assert gnss.utc is not None
    assert len(set(gnss.utc[stuck])) == 1
    assert np.array_equal(gnss.speed[~out & ~stuck], free.gnss.speed[~out & ~stuck])


@pytest.mark.parametrize("rate", [10.0, 16.8, 50.0, 100.0, 200.0, 400.0])
def test_any_rate_samples_the_same_drive(rate: float) -> None:
    scenario = Scenario(duration=20.0, accel_rate=rate, sampling_jitter=0.3, stamp_jitter=1e-3)
    drive, truth = simulate(scenario, seed=12)
    _, fine = simulate(replace(scenario, accel_rate=1000.0, sampling_jitter=0.0), seed=12)
    assert drive.inertial.t.size == np.ceil(20.0 * rate)
    steps = np.diff(truth.t) * rate
    assert steps.min() > 0.0
    assert steps.std() == pytest.approx(np.sqrt(2.0) * 0.27, rel=0.2)
    assert np.abs(drive.inertial.t - truth.t).max() <= 0.005
    inside = truth.t < fine.t[-1]
    assert np.allclose(truth.v[inside], np.interp(truth.t[inside], fine.t, fine.v), atol=1e-5)


def test_the_clock_of_the_box_drifts_against_utc() -> None:
    drive, _ = simulate(Scenario(duration=300.0, clock_drift=1e-4), seed=13)
    utc = drive.gnss.utc
    assert utc is not None
    assert np.polyfit(drive.gnss.t, utc - utc[0], 1)[0] == pytest.approx(1.0 + 1e-4, abs=1e-6)


def test_an_antenna_away_from_the_box_moves_by_itself() -> None:
    scenario = replace(Scenario(route="roundabout", duration=60.0).faultless(), lever_arm=(0.0, 0.0, 0.0))
    at_box, _ = simulate(scenario, seed=14)
    ahead, truth = simulate(replace(scenario, antenna_arm=(2.0, 0.0, 0.0)), seed=14)
    turn = np.interp(ahead.gnss.t, truth.t, truth.w_z)
    speed = np.hypot(at_box.gnss.speed, 2.0 * turn)
    assert np.allclose(ahead.gnss.speed, speed, atol=5e-3)


def test_no_receiver_and_half_a_second() -> None:
    drive, truth = simulate(Scenario(duration=0.5, gnss_rate=0.0), seed=15)
    assert drive.gnss.t.size == 0
    assert drive.inertial.t.size == truth.t.size == 100


def test_the_same_seed_gives_the_same_bytes() -> None:
    scenario = Scenario(duration=30.0, with_gyro=True, sampling_jitter=0.1)
    (one, truth_one), (other, truth_other) = simulate(scenario, seed=16), simulate(scenario, seed=16)
    for name in ("t", "f", "w"):
        assert getattr(one.inertial, name).tobytes() == getattr(other.inertial, name).tobytes()
    for name in ("t", "lat", "lon", "alt", "speed", "course", "fix", "utc"):
        assert getattr(one.gnss, name).tobytes() == getattr(other.gnss, name).tobytes()
    assert truth_one.position.tobytes() == truth_other.position.tobytes()
    third, _ = simulate(scenario, seed=17)
    assert one.inertial.f.tobytes() != third.inertial.f.tobytes()


def test_instruments_do_not_change_the_drive() -> None:
    scenario = Scenario(duration=30.0)
    _, truth = simulate(scenario, seed=18)
    _, same = simulate(replace(scenario, accel_noise=0.5, gnss_rate=10.0, R_va=MOUNT, vibration=0.0), seed=18)
    assert np.array_equal(truth.f_v, same.f_v)
    assert np.array_equal(truth.accel_bias, same.accel_bias)


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"duration": 0.0}, RangeError),
        ({"accel_rate": -1.0}, RangeError),
        ({"speed_lag": 6.0}, RangeError),
        ({"gnss_jitter": 0.3}, RangeError),
        ({"gnss_smoothing": -0.1}, RangeError),
        ({"R_va": np.zeros(3)}, ShapeError),
        ({"impacts": (Impact(t=400.0, delta_v=1.0),)}, RangeError),
        ({"moves": (Move(t=9.0), Move(t=3.0))}, OrderError),
    ],
)
def test_scenarios_without_a_meaning_are_refused(fields: dict[str, object], error: type[Exception]) -> None:
    with pytest.raises(error):
        Scenario(**fields)


@given(
    route=st.sampled_from(["static", "straight", "urban", "gentle", "highway", "roundabout"]),
    duration=st.floats(0.3, 40.0),
    accel_rate=st.floats(10.0, 250.0),
    gnss_rate=st.sampled_from([0.0, 1.0, 4.0, 10.0]),
    jitter=st.floats(0.0, 0.5),
    with_gyro=st.booleans(),
    struck=st.booleans(),
    seed=st.integers(0, 2**32),
)
@settings(max_examples=40, deadline=None)
def test_every_scenario_gives_a_sound_drive(
    route: str,
    duration: float,
    accel_rate: float,
    gnss_rate: float,
    jitter: float,
    with_gyro: bool,
    struck: bool,
    seed: int,
) -> None:
    impacts = (Impact(t=0.4 * duration, delta_v=7.0, pdof=2.0, yaw_rate_change=-1.0),) if struck else ()
    scenario = Scenario(
        route=route,
        duration=duration,
        accel_rate=accel_rate,
        gnss_rate=gnss_rate,
        sampling_jitter=jitter,
        stamp_jitter=0.01 * jitter,
        with_gyro=with_gyro,
        impacts=impacts,
    )
    drive, truth = simulate(scenario, seed=seed)  # the records check order, shapes and finiteness
    n = drive.inertial.t.size
    assert n == max(np.ceil(duration * accel_rate - 1e-9), 1)
    assert (drive.inertial.w is not None) == with_gyro
    assert drive.inertial.t[-1] < duration + 1.0 / accel_rate
    assert np.isfinite(truth.f_v).all()
    assert np.isfinite(truth.position).all()
    assert truth.R_tv.shape == (n, 3, 3)
    assert len(truth.events) == len(impacts)
    assert np.abs(drive.inertial.f).max() <= scenario.accel_full_scale
    if drive.gnss.t.size:
        assert np.isfinite(drive.gnss.lat).all()
        assert drive.gnss.course.min() >= 0.0
        assert drive.gnss.course.max() < 2.0 * np.pi + 1e-12
