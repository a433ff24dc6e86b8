"""The thesis' filter over drives: measurement vectors, agreement with the reference, what each correction changes."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nav_core.errors import TooLittleDataError
from nav_core.mounting import thesis_kernel, thesis_reference
from nav_core.mounting.thesis import Start, estimate_thesis, initial_states, levelled, run_thesis
from nav_core.mounting.thesis_model import CORRECTED, GRAVITY, PRINTED, Steps, Tuning, errata_named, measurement_vectors
from nav_core.records import Drive, Gnss, Inertial
from nav_core.rotation import angle_between, error_between, thesis_to_matrix
from nav_core.simulate import Scenario, simulate

TUNING = Tuning()
SENSIBLE_PRINT = PRINTED._replace(covariance=True)
"""The printed equations with the covariance update that they must have meant."""

compiled = settings(deadline=None, max_examples=60)
"""The first example of a kernel pays for its compilation."""

MIRROR = np.diag([-1.0, -1.0, 1.0])
THESIS_POSES = [(-180.0, 90.0, 0.0), (-90.0, 0.0, 40.0)]


@lru_cache(maxsize=8)
def driven(route, duration, seed, triple=None, gnss_rate=4.0):
    R_va = None if triple is None else thesis_to_matrix(*np.radians(triple))
    scenario = Scenario(route=route, duration=duration, R_va=R_va, accel_rate=50.0, gnss_rate=gnss_rate)
    return simulate(scenario, seed=seed)


def constructed(*, v, course, climb, f_v, R_va, duration, rate=4.0, t0=0.0):
    """An exact drive from functions of time: speed, course (clockwise), vertical speed up, specific force in V."""
    t = np.arange(0.0, duration, 1.0 / 20.0)
    ti = np.arange(2, int(duration * rate) - 2) / rate
    alt = np.interp(ti, t, np.cumsum(climb(t)) / 20.0)
    zero = np.zeros_like(ti)
    return Drive(
        Inertial(t + t0, f_v(t) @ R_va),
        Gnss(ti + t0, zero, ti * 1e-6, alt, v(ti), np.mod(course(ti), 2.0 * np.pi), np.ones(ti.size, dtype=bool)),
    )


def level_start(steps, R_va, *, mirrored=False):
    """A start at the truth, or at its mirror image: backwards, vehicle and box turned by 180°."""
    heading = np.arctan2(steps.velocity[0, 1], steps.velocity[0, 0])
    R_tv = Rotation.from_rotvec([0.0, 0.0, heading]).as_matrix()
    x = np.zeros(9)
    x[0] = steps.speed[0]
    if mirrored:
        R_tv, R_va, x[0] = R_tv @ MIRROR, MIRROR @ R_va, -x[0]
    P = np.diag([0.3, 1.0, 0.01, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-2])
    return Start(x, P, Rotation.from_matrix(R_tv).as_quat(), Rotation.from_matrix(R_va).as_quat())


def first(steps, n):
    return Steps(*(column[:n] for column in steps))


# --- measurement vectors ---------------------------------------------------------------------------------------


def circling(w=0.2, v=10.0, climb=0.0, duration=60.0):
    slope = np.arcsin(climb / v)
    return constructed(
        v=lambda t: np.full_like(t, v),
        course=lambda t: w * t,
        climb=lambda t: np.full_like(t, climb),
        f_v=lambda t: np.tile([GRAVITY * np.sin(slope), v * w, -GRAVITY * np.cos(slope)], (t.size, 1)),
        R_va=np.eye(3),
        duration=duration,
    )


def test_passing_north_makes_no_peak():
    steps = measurement_vectors(circling())
    assert np.allclose(steps.turn_rate[1:], 0.2, atol=1e-9)
    assert steps.turning[1:].all()


def test_the_printed_vector_counts_counter_clockwise_and_upwards():
    drive = circling(climb=0.5)
    corrected, printed = measurement_vectors(drive), measurement_vectors(drive, PRINTED)
    assert np.allclose(printed.turn_rate, -corrected.turn_rate)
    assert np.allclose(printed.velocity[:, :2], corrected.velocity[:, :2])
    assert np.allclose(printed.velocity[10:, 2], 0.5, atol=0.03)
    assert np.allclose(corrected.velocity[60:, 2], -0.5, atol=0.03)


def test_course_is_held_while_standing_and_its_jump_is_no_turn():
    def speed(t):
        return np.where((t > 10.0) & (t < 20.0), 0.0, 8.0)

    drive = constructed(
        v=speed,
        course=lambda t: np.where(t <= 10.0, 1.0, np.where(t < 20.0, 5.0 * t, 2.0)),
        climb=np.zeros_like,
        f_v=lambda t: np.tile([0.0, 0.0, -GRAVITY], (t.size, 1)),
        R_va=np.eye(3),
        duration=30.0,
    )
    steps = measurement_vectors(drive)
    assert np.allclose(steps.turn_rate[steps.turning], 0.0)
    assert np.count_nonzero(~steps.turning) == 2, "the first row and the first after the stop"


def test_repeated_fixes_are_left_out():
    gnss = circling().gnss
    again = np.repeat(np.arange(gnss.t.size), 2)
    t = gnss.t[again] + np.tile([0.0, 0.1], gnss.t.size)
    frozen = Gnss(t, *(getattr(gnss, n)[again] for n in ("lat", "lon", "alt", "speed", "course", "fix")))
    steps = measurement_vectors(Drive(circling().inertial, frozen))
    assert np.allclose(steps.t, gnss.t)
    assert np.allclose(steps.turn_rate[1:], 0.2, atol=1e-9)


def test_fast_receivers_are_thinned_to_the_rate_of_the_tuning():
    drive = constructed(
        v=lambda t: np.full_like(t, 10.0),
        course=lambda t: 0.1 * t,
        climb=np.zeros_like,
        f_v=lambda t: np.tile([0.0, 1.0, -GRAVITY], (t.size, 1)),
        R_va=np.eye(3),
        duration=40.0,
        rate=10.0,
    )
    steps = measurement_vectors(drive)
    assert steps.period[1:].mean() == pytest.approx(0.25, abs=0.005)
    assert np.allclose(steps.turn_rate[1:], 0.1, atol=1e-9)


@pytest.mark.parametrize("kept", [0, 1])
def test_too_few_fixes_are_refused(kept):
    drive = circling()
    gnss = drive.gnss
    fix = np.arange(gnss.t.size) < kept
    few = Gnss(gnss.t, gnss.lat, gnss.lon, gnss.alt, gnss.speed, gnss.course, fix)
    with pytest.raises(TooLittleDataError):
        measurement_vectors(Drive(drive.inertial, few))
    estimate = estimate_thesis(Drive(drive.inertial, few))
    assert estimate.status == "insufficient"
    assert [r.code for r in estimate.reasons] == ["no_fix"]


def test_fixes_without_accelerometer_data_are_refused():
    drive = circling()
    for inertial in (Inertial(np.zeros(0), np.zeros((0, 3))), Inertial(drive.inertial.t + 500.0, drive.inertial.f)):
        with pytest.raises(TooLittleDataError):
            measurement_vectors(Drive(inertial, drive.gnss))


# --- the whole filter ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("errata", "rows", "steering"),
    [(CORRECTED, 500, False), (SENSIBLE_PRINT, 500, False), (PRINTED, 40, False), (CORRECTED, 500, True)],
)
def test_the_kernel_agrees_with_the_matrices(errata, rows, steering):
    tuning = TUNING._replace(steering=steering)
    scenario = Scenario(route="urban", duration=150.0, accel_rate=50.0, outages=((60.0, 70.0),))
    steps = first(measurement_vectors(simulate(scenario, seed=3)[0], errata), rows)
    start = initial_states(steps, tuning, errata)[0]
    q_A, motion, covariance, chi2 = thesis_reference.filter_reference(steps, *start, tuning, errata)
    done, *kernel = thesis_kernel.filter_drive(steps, *(a.copy() for a in start), tuning, errata)
    assert done == steps.t.size
    signs = np.sign(np.einsum("ij,ij->i", q_A, kernel[0]))
    assert np.allclose(q_A * signs[:, None], kernel[0], atol=1e-9)
    assert np.allclose(motion, kernel[2], atol=1e-9)
    assert np.allclose(covariance, kernel[3], rtol=1e-9, atol=1e-9)
    assert np.allclose(chi2, kernel[5], rtol=1e-9, atol=1e-9)


def test_steering_for_turn_rate_is_the_same_estimator():
    """4.10: the curvature in place of the turn rate; the thesis chose the latter because it is measured directly."""
    drive, truth = driven("urban", 200.0, 11)
    plain, steered = run_thesis(drive), run_thesis(drive, tuning=TUNING._replace(steering=True))
    ends = [Rotation.from_quat(run.history.q_A[-1]).as_matrix() for run in (plain, steered)]
    assert np.degrees(angle_between(*ends)) < 5.0
    assert np.degrees(angle_between(ends[1], truth.R_va)) < 10.0
    moving = steered.steps.speed > 4.0
    apart = plain.history.motion[moving, 2] - steered.history.motion[moving, 2]
    assert np.sqrt(np.mean(apart**2)) < 0.03


def test_a_start_at_the_truth_of_an_exact_drive_stays_there():
    drive = circling()
    run = run_thesis(drive, start=level_start(measurement_vectors(drive), np.eye(3)))
    assert np.degrees(angle_between(Rotation.from_quat(run.history.q_A[-1]).as_matrix(), np.eye(3))) < 0.5
    assert run.history.motion[-1] == pytest.approx([10.0, 0.0, 0.2], abs=0.02)
    assert np.median(run.history.chi2) < 0.1


def test_only_the_corrected_sign_of_the_climb_pitches_the_vehicle_up():
    drive = circling(w=0.0, climb=1.0, duration=120.0)

    def pitch(errata):
        run = run_thesis(drive, errata=errata, start=level_start(measurement_vectors(drive, errata), np.eye(3)))
        ahead = Rotation.from_quat(run.history.q_V[-1]).as_matrix()[:, 0]
        return np.degrees(np.arcsin(-ahead[2]))

    uphill = np.degrees(np.arcsin(0.1))
    assert pitch(CORRECTED) == pytest.approx(uphill, abs=0.6)
    assert pitch(CORRECTED._replace(descent=False)) == pytest.approx(-uphill, abs=0.6)


def test_the_mirror_solution_satisfies_the_print_and_not_the_correction():
    drive, _ = driven("urban", 150.0, 2, (-90.0, 0.0, 40.0))
    R_va = thesis_to_matrix(*np.radians([-90.0, 0.0, 40.0]))

    def ends(errata, *, mirrored):
        start = level_start(measurement_vectors(drive, errata), R_va, mirrored=mirrored)
        run = run_thesis(drive, errata=errata, start=start)
        return run, Rotation.from_quat(run.history.q_A[-1]).as_matrix()

    for errata in (SENSIBLE_PRINT, CORRECTED._replace(forward=False)):
        run, R = ends(errata, mirrored=False)
        twin, R_twin = ends(errata, mirrored=True)
        assert np.allclose(twin.history.chi2, run.history.chi2, rtol=1e-6, atol=1e-6)
        assert np.allclose(twin.history.motion[:, 0], -run.history.motion[:, 0], atol=1e-6)
        assert angle_between(R_twin, MIRROR @ R) < 1e-6
    right, _ = ends(CORRECTED, mirrored=False)
    wrong, _ = ends(CORRECTED, mirrored=True)
    assert wrong.history.motion[:, 0].min() >= 0.0
    assert wrong.history.chi2.sum() > 1.3 * right.history.chi2.sum()
    # Of the four starting yaws the innovations pick one that leads to the truth.
    assert np.degrees(angle_between(Rotation.from_quat(run_thesis(drive).flow.mean[-1]).as_matrix(), R_va)) < 10.0


def test_the_printed_covariance_update_is_none():
    drive, _ = driven("urban", 150.0, 2, (-90.0, 0.0, 40.0))
    sound, broken = run_thesis(drive), run_thesis(drive, errata="printed")
    assert np.linalg.eigvalsh(sound.history.mounting_covariance).min() > 0.0
    rows = broken.history.mounting_covariance[: broken.done]
    assert np.linalg.eigvalsh(rows).min() < 0.0
    assert np.abs(rows).max() > 100.0  # rad²: no angle varies that much
    estimate = estimate_thesis(drive, errata="printed")
    assert estimate.status == "insufficient"
    assert estimate.R_va is None
    assert [r.code for r in estimate.reasons] == ["filter_lost"]


def test_a_filter_that_blows_up_stops():
    drive, _ = driven("urban", 150.0, 2, (-90.0, 0.0, 40.0))
    steps = measurement_vectors(drive)
    start = initial_states(steps, TUNING, CORRECTED)[0]
    f = steps.f.copy()
    f[100] = np.nan
    done, *columns = thesis_kernel.filter_drive(steps._replace(f=f), *(a.copy() for a in start), TUNING, CORRECTED)
    assert done == 100
    assert np.isnan(columns[0][100:]).all()
    assert np.isfinite(columns[0][:100]).all()


@pytest.mark.parametrize("triple", THESIS_POSES)
def test_corrected_converges_on_curvy_drives_at_the_poses_of_the_thesis(triple):
    R_va = thesis_to_matrix(*np.radians(triple))
    errors = []
    for seed in range(4):
        run = run_thesis(driven("urban", 200.0, seed, triple)[0])
        errors.append(np.degrees(angle_between(Rotation.from_quat(run.flow.mean[-1]).as_matrix(), R_va)))
        assert run.history.motion[:, 0].min() >= 0.0
    # 001 table 5.3 adds up to 6.7° in root mean square of the three mean errors; here without straight drives.
    assert np.median(errors) < 5.0
    assert np.max(errors) < 10.0


def test_the_printed_equations_often_end_in_a_wrong_solution():
    wrong = {"corrected": 0, "sensible print": 0}
    for triple in THESIS_POSES:
        for seed in range(4):
            drive, _ = driven("urban", 200.0, seed, triple)
            for name, errata in (("corrected", CORRECTED), ("sensible print", SENSIBLE_PRINT)):
                R = Rotation.from_quat(run_thesis(drive, errata=errata).flow.mean[-1]).as_matrix()
                wrong[name] += angle_between(R, thesis_to_matrix(*np.radians(triple))) > np.radians(20.0)
    assert wrong["corrected"] == 0
    assert wrong["sensible print"] >= 2


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_other_receiver_rates(rate):
    drive, truth = driven("urban", 240.0, 5, gnss_rate=rate)
    run = run_thesis(drive)
    assert np.degrees(angle_between(Rotation.from_quat(run.flow.mean[-1]).as_matrix(), truth.mountings[0][1])) < 10.0


def test_the_start_is_levelled_and_one_yaw_is_near():
    R_va = thesis_to_matrix(*np.radians([20.0, -35.0, 110.0]))
    drive = constructed(
        v=lambda t: np.full_like(t, 10.0),
        course=lambda t: np.full_like(t, 2.0),
        climb=np.zeros_like,
        f_v=lambda t: np.tile([0.0, 0.0, -GRAVITY], (t.size, 1)),
        R_va=R_va,
        duration=20.0,
    )
    starts = initial_states(measurement_vectors(drive), TUNING, CORRECTED)
    errors = np.array([error_between(Rotation.from_quat(s.q_A).as_matrix(), R_va) for s in starts])
    assert np.allclose(errors[:, :2], 0.0, atol=1e-6)
    assert np.abs(errors[:, 2]).min() <= np.pi / 4.0 + 1e-9
    assert starts[0].x[0] == pytest.approx(10.0)
    (printed,) = initial_states(measurement_vectors(drive), TUNING, PRINTED)
    assert not printed.x.any()
    assert np.array_equal(printed.q_A, [0.0, 0.0, 0.0, 1.0])
    assert printed.P[6, 6] == pytest.approx(0.1)


@compiled
@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(np.array).filter(lambda f: np.linalg.norm(f) > 1.0))
def test_levelling_takes_the_specific_force_up(f):
    R = Rotation.from_quat(levelled(f)).as_matrix()
    assert np.allclose(R @ f, [0.0, 0.0, -np.linalg.norm(f)], atol=1e-5)


def test_levelling_upside_down():
    assert np.allclose(
        Rotation.from_quat(levelled(np.array([0.0, 0.0, 9.8]))).as_matrix() @ [0.0, 0.0, 1.0], [0, 0, -1]
    )


def test_a_gap_restarts_the_vehicle_and_keeps_the_mounting():
    scenario = Scenario(route="urban", duration=200.0, accel_rate=50.0, outages=((120.0, 150.0),))
    drive, truth = simulate(scenario, seed=4)
    run = run_thesis(drive)
    k = int(np.argmax(run.steps.period))
    assert run.steps.period[k] > 20.0
    R = Rotation.from_quat(run.history.q_A[[k - 1, k]]).as_matrix()
    assert np.degrees(angle_between(R[0], R[1])) < 15.0
    assert run.history.motion[k, 0] == pytest.approx(run.steps.speed[k], abs=1.0)
    assert np.degrees(angle_between(Rotation.from_quat(run.flow.mean[-1]).as_matrix(), truth.mountings[0][1])) < 10.0


def test_errata_by_name():
    assert errata_named("corrected") is CORRECTED
    assert errata_named("printed") is PRINTED
    assert errata_named(SENSIBLE_PRINT) is SENSIBLE_PRINT
    assert all(CORRECTED)
    assert not any(PRINTED)
