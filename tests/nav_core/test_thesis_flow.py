"""The program around the thesis' filter: moving average, STABLE, RELIABLE, test routine, statuses."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.mounting.thesis import estimate_thesis, run_thesis
from nav_core.mounting.thesis_flow import (
    STABLE_STEP,
    TEST_LIMIT,
    WINDOW,
    curves,
    follow_flow_chart,
    moving_average,
    run_test,
    settled,
)
from nav_core.mounting.thesis_model import GRAVITY, MOVING, Steps
from nav_core.mounting.thesis_moved import watch
from nav_core.rotation import angle_between
from nav_core.simulate import Move, Scenario, simulate

RATE = 4.0
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def level_drive(duration, *, turn_at=(), v=10.0, tilt=0.0, course=0.0):
    """Rows of a level road at constant speed with 3 s turns of 0.4 rad/s; the box pitched by `tilt`."""
    n = int(duration * RATE)
    t = np.arange(n) / RATE
    turn_rate = np.zeros(n)
    for begin in turn_at:
        turn_rate[(t > begin) & (t <= begin + 3.0)] = 0.4
    heading = course + np.cumsum(turn_rate) / RATE
    f = np.tile(Rotation.from_rotvec([0.0, -tilt, 0.0]).as_matrix() @ [0.0, 0.0, -GRAVITY], (n, 1))
    f[:, 1] += v * turn_rate
    velocity = v * np.stack([np.cos(heading), np.sin(heading), 0.0 * t], axis=1)
    return Steps(t, np.full(n, 1.0 / RATE), f, velocity, turn_rate, np.full(n, v > MOVING), np.full(n, v))


def constant(n, q=IDENTITY):
    return np.tile(q, (n, 1))


def test_the_average_is_of_the_last_hundred():
    rng = np.random.default_rng(3)
    q = Rotation.from_rotvec(0.05 * rng.standard_normal((300, 3))).as_quat()
    mean = moving_average(q)
    assert np.isnan(mean[: WINDOW - 1]).all()
    for k in (WINDOW - 1, 200, 299):
        expected = q[k - WINDOW + 1 : k + 1].mean(axis=0)
        assert np.allclose(mean[k], expected / np.linalg.norm(expected), atol=1e-12)


def test_q_and_minus_q_are_averaged_as_one_rotation():
    q = Rotation.from_rotvec([[0.0, 0.0, np.pi + 0.01 * k] for k in range(-60, 60)]).as_quat()
    flipped = q * np.where(np.arange(120) % 3 == 0, -1.0, 1.0)[:, None]
    mean = Rotation.from_quat(moving_average(flipped)[-1]).as_matrix()
    assert angle_between(mean, Rotation.from_rotvec([0.0, 0.0, np.pi + 0.095]).as_matrix()) < 1e-6
    # Without alignment, as 5.4 is printed, the sum nearly cancels.
    assert np.linalg.norm(flipped[-WINDOW:].mean(axis=0)) < 0.5


def test_a_short_history_has_no_average():
    assert np.isnan(moving_average(constant(WINDOW - 1))).all()


def test_stable_needs_a_hundred_samples_and_a_still_average():
    still = settled(moving_average(constant(200)))
    assert not still[:WINDOW].any()
    assert still[WINDOW:].all()
    for rate, expected in ((0.9 * STABLE_STEP, True), (1.1 * STABLE_STEP, False)):
        turning = Rotation.from_rotvec(np.outer(np.arange(300) * rate, [0.0, 0.0, 1.0])).as_quat()
        assert settled(moving_average(turning))[WINDOW + 1 :].all() == expected


def test_a_turn_is_a_curve_and_passing_north_is_none():
    steps = level_drive(60.0, turn_at=(30.0,), course=-0.3)
    seen = curves(steps)
    assert not seen[steps.t <= 30.0].any()
    assert seen[(steps.t > 31.0) & (steps.t < 33.0)].all()
    assert not curves(level_drive(60.0)).any()


def test_a_turn_while_creeping_is_no_curve():
    assert not curves(level_drive(60.0, turn_at=(30.0,), v=2.0)).any()


def test_course_noise_is_no_curve():
    steps = level_drive(600.0, v=3.5)
    noise = 0.08 / 3.5 * np.random.default_rng(1).standard_normal(steps.t.size + 1)
    assert not curves(steps._replace(turn_rate=np.diff(noise) * RATE)).any()


def test_a_jump_after_standing_is_no_curve():
    steps = level_drive(60.0)
    turning = steps.turning.copy()
    turn_rate = steps.turn_rate.copy()
    turning[100], turn_rate[100] = False, 3.0
    assert not curves(steps._replace(turning=turning, turn_rate=turn_rate)).any()


def test_the_test_routine_integrates_gravity_of_a_tilted_mounting():
    steps = level_drive(120.0, tilt=np.radians(1.0))
    trial = run_test(steps, constant(steps.t.size), 100)
    assert trial.complete
    assert trial.duration == pytest.approx(40.0)
    # g sin 1° over 40 s: 2.5 m/s correspond to 0.37°.
    assert trial.drift == pytest.approx(GRAVITY * np.sin(np.radians(1.0)) * 40.0, rel=1e-9)
    assert not trial.passed
    right = run_test(steps, constant(steps.t.size, Rotation.from_rotvec([0.0, np.radians(1.0), 0.0]).as_quat()), 100)
    assert right.drift < 1e-9
    assert right.passed
    assert TEST_LIMIT == 2.5


def test_the_test_routine_follows_accelerating():
    steps = level_drive(120.0)
    a = 0.2 * np.sin(0.3 * steps.t)
    f = steps.f.copy()
    f[:, 0] = a
    speed = 10.0 + np.cumsum(a) / RATE
    assert run_test(steps._replace(f=f, speed=speed), constant(steps.t.size), 120).drift < 1e-9


def test_a_test_routine_across_a_hole_or_the_end_gives_no_verdict():
    steps = level_drive(120.0)
    period = steps.period.copy()
    period[150] = 8.0
    assert not run_test(steps._replace(period=period), constant(steps.t.size), 120).complete
    short = run_test(steps, constant(steps.t.size), steps.t.size - 40)
    assert not short.complete
    assert not short.passed
    assert short.duration == pytest.approx(39.0 / RATE)


def test_flow_chart_saves_when_the_flags_meet_and_ends_when_the_test_passes():
    steps = level_drive(200.0, turn_at=(50.0,))
    flow = follow_flow_chart(steps, constant(steps.t.size))
    (trial,) = flow.trials
    assert 50.0 < steps.t[trial.saved] < 53.0
    assert trial.passed
    assert flow.finished == trial.ended
    assert steps.t[flow.finished] - steps.t[trial.saved] == pytest.approx(40.0)
    # The soft initialisation lowers RELIABLE; the rest of the same curve raises it again.
    assert not flow.reliable[: trial.saved].any()
    assert flow.reliable[flow.finished]


def test_flow_chart_tries_again_after_a_failed_test():
    steps = level_drive(300.0, turn_at=(50.0, 120.0), tilt=np.radians(1.0))
    q = constant(steps.t.size)
    right = Rotation.from_rotvec([0.0, np.radians(1.0), 0.0]).as_quat()
    q[steps.t > 70.0] = right
    flow = follow_flow_chart(steps, q)
    assert [trial.passed for trial in flow.trials] == [False, True]
    assert flow.trials[1].saved > flow.trials[0].ended
    assert flow.finished is not None


def test_no_curve_no_mounting():
    steps = level_drive(200.0)
    flow = follow_flow_chart(steps, constant(steps.t.size))
    assert flow.stable[WINDOW:].all()
    assert not flow.reliable.any()
    assert flow.trials == ()
    assert flow.finished is None


# --- statuses on simulated drives ------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def driven(route, duration, seed):
    quiet = {"slope": 0.0, "accel_bias": 0.0} if route == "urban" else {}
    return simulate(Scenario(route=route, duration=duration, accel_rate=50.0, **quiet), seed=seed)


def test_a_passed_test_is_not_enough_while_the_filter_doubts():
    drive, truth = driven("urban", 300.0, 1)
    run, estimate = run_thesis(drive), estimate_thesis(drive)
    assert run.flow.finished is not None
    assert estimate.self_test.passed
    assert np.degrees(estimate.sigma.max()) > 5.0
    assert estimate.status == "settling"
    assert estimate.progress < 1.0
    assert [reason.code for reason in estimate.reasons] == ["unsure"]
    assert np.degrees(angle_between(estimate.R_va, truth.mountings[0][1])) < 8.0


def test_a_level_town_ends_ready():
    drive, truth = driven("urban", 900.0, 3)
    estimate = estimate_thesis(drive)
    assert estimate.status == "ready"
    assert np.degrees(estimate.sigma.max()) < 5.0
    assert estimate.method == "mekf"
    assert estimate.stable
    assert estimate.reliable
    assert estimate.progress == 1.0
    assert estimate.reasons == ()
    assert estimate.self_test.passed
    assert estimate.self_test.drift < TEST_LIMIT
    assert estimate.self_test.duration == pytest.approx(40.0, abs=0.5)
    assert np.degrees(angle_between(estimate.R_va, truth.mountings[0][1])) < 8.0
    assert np.all(estimate.sigma > 0.0)
    assert 0.0 < estimate.observability < 1.0


def test_before_the_test_is_over_it_is_settling():
    drive, _ = driven("urban", 300.0, 1)
    run = run_thesis(drive)
    until = run.steps.t[run.flow.trials[-1].saved] + 20.0
    inertial, gnss = drive.inertial, drive.gnss
    cut_a, cut_g = inertial.t < until + 1.0, gnss.t < until
    columns = {name: getattr(gnss, name)[cut_g] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")}
    shortened = type(drive)(type(inertial)(inertial.t[cut_a], inertial.f[cut_a]), type(gnss)(**columns))
    estimate = estimate_thesis(shortened)
    assert estimate.status == "settling"
    assert estimate.R_va is not None
    assert 0.4 < estimate.progress < 1.0
    assert any(reason.code in {"self_test_running", "not_stable"} for reason in estimate.reasons)


def test_a_straight_road_is_insufficient():
    estimate = estimate_thesis(driven("straight", 200.0, 1)[0])
    assert estimate.status == "insufficient"
    assert not estimate.reliable
    assert "no_turns" in [reason.code for reason in estimate.reasons]


def test_standing_is_insufficient():
    estimate = estimate_thesis(driven("static", 60.0, 1)[0])
    assert estimate.status == "insufficient"
    assert [reason.code for reason in estimate.reasons] == ["not_moving"]


def test_a_minute_is_too_short():
    estimate = estimate_thesis(driven("urban", 20.0, 1)[0])
    assert estimate.status == "insufficient"
    assert "too_short" in [reason.code for reason in estimate.reasons]


def test_standing_leaves_the_yaw_unknown():
    standing, town = (run_thesis(driven(route, 200.0, 2)[0]).history for route in ("static", "urban"))
    # 001 figs. 5.3 and 5.7: the largest share of the covariance lies in one direction while standing.
    assert standing.observability[WINDOW] < town.observability[WINDOW] - 0.1
    yaw = [np.degrees(np.sqrt(np.median(history.mounting_covariance[:, 2, 2]))) for history in (standing, town)]
    assert yaw[0] > 30.0
    assert yaw[1] < 20.0
    for history in (standing, town):
        assert np.all((history.largest_eigenvalue >= 1.0) & (history.largest_eigenvalue <= 9.0))


# --- a moved box (001 §5.5) ------------------------------------------------------------------------------------


def test_periodic_starts_find_a_moved_box_and_leave_a_fixed_one_alone():
    level = {"slope": 0.0, "crown": 0.0, "bank": 0.0, "accel_bias": 0.0, "accel_rate": 50.0}
    still, _ = simulate(Scenario(route="urban", duration=900.0, **level), seed=5)
    seen = watch(still)
    assert len(seen.starts) == 3
    assert sum(start.R_va is not None for start in seen.starts) >= 2
    assert seen.changes == ()
    moves = (Move(t=300.0, turn=(0.0, 0.0, np.radians(40.0))),)
    moved, truth = simulate(Scenario(route="urban", duration=900.0, moves=moves, **level), seed=5)
    found = watch(moved, memory=truth.mountings[0][1])
    assert len(found.changes) == 1
    assert found.changes[0].t > 300.0
    assert np.degrees(found.changes[0].angle) == pytest.approx(40.0, abs=12.0)
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 12.0


def test_a_watch_needs_a_passed_test():
    drive, _ = simulate(Scenario(route="static", duration=60.0, accel_rate=50.0), seed=1)
    memory = np.eye(3)
    seen = watch(drive, memory=memory)
    assert [start.R_va for start in seen.starts] == [None]
    assert seen.R_va is memory
