"""The online estimator: kernel against matrices, streaming, hypotheses, convergence, what it refuses."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.errors import ShapeError
from nav_core.mounting import estimate_mounting, online_reference
from nav_core.mounting.online import OnlineState, advance, advance_fleet, begin
from nav_core.mounting.online_hearing import TRUSTED
from nav_core.mounting.online_hypotheses import stack
from nav_core.mounting.online_kernel import run
from nav_core.mounting.online_model import GYRO, HYPOTHESES, N_STATES, TURN, Filters, Tuning
from nav_core.mounting.online_stream import Chunk, chunks_of, joined
from nav_core.mounting.online_tally import covariance_of, mounting_of
from nav_core.mounting.online_verdict import assess
from nav_core.records import Drive, Gnss, Inertial
from nav_core.rotation import angle_between, error_between
from nav_core.simulate import Move, Scenario, Truth, simulate
from nav_core.simulate import faults as fault


@lru_cache(maxsize=12)
def drive_of(route: str, duration: float, seed: int, gyro: bool = False, rate: float = 4.0) -> tuple[Drive, Truth]:
    return simulate(
        Scenario(route=route, duration=duration, gnss_rate=rate, with_gyro=gyro, accel_rate=100.0),  # type: ignore[arg-type]
        seed=seed,
    )


def run_through(drive: Drive, stride: float = 5.0, first: OnlineState | None = None) -> list[OnlineState]:
    states = [first or begin()]
    for chunk in chunks_of(drive, stride):
        states.append(advance(states[-1], chunk))
    return states[1:]


def captured_rows(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> tuple[Filters, np.ndarray]:
    """The filters at the start and all rows of a drive."""
    from nav_core.mounting import online

    starts, rows = [], []

    def listen(filters, each, first, last, tuning, trace):
        starts.append(Filters(*(column.copy() for column in filters)))
        rows.append(each.copy())
        run(filters, each, first, last, tuning, trace)

    monkeypatch.setattr(online, "run", listen)
    run_through(drive, first=replace(begin(), gyro=TRUSTED))
    return starts[0], np.concatenate(rows)


@pytest.mark.parametrize("gyro", [False, True])
def test_the_kernel_agrees_with_the_matrices(gyro: bool, monkeypatch: pytest.MonkeyPatch):
    drive, _ = drive_of("urban", 60.0, 7, gyro)
    start, rows = captured_rows(drive, monkeypatch)
    assert np.isfinite(rows[:, GYRO]).mean() == pytest.approx(float(gyro), abs=0.05)
    rows[40, 13] = 1.0  # a step without accelerometer data
    one = Filters(*(column[2:3].copy() for column in start))
    many = Filters(*(column.copy() for column in one))
    run(many, rows, np.array([0]), np.array([len(rows)]), Tuning(), np.zeros((0, 4)))
    for row in rows:
        one = online_reference.step(one, row, Tuning())
    for name in ("x", "R_va", "notes"):
        np.testing.assert_allclose(getattr(many, name), getattr(one, name), rtol=1e-6, atol=1e-7)
    scale = np.sqrt(np.diag(one.P[0]))
    np.testing.assert_allclose(many.P[0] / np.outer(scale, scale), one.P[0] / np.outer(scale, scale), atol=1e-6)
    assert many.likelihood[0] == pytest.approx(one.likelihood[0], rel=1e-8)


def test_the_reference_jacobian_against_differences(monkeypatch: pytest.MonkeyPatch):
    drive, _ = drive_of("urban", 60.0, 7)
    start, rows = captured_rows(drive, monkeypatch)
    rng = np.random.default_rng(1)
    x = start.x[0] + 0.01 * rng.standard_normal(N_STATES)
    row, R_va = rows[100], start.R_va[0]

    def following(at):
        F, u, _ = online_reference.transition(at, row, R_va, Tuning())
        return F @ at + u

    _, _, jacobian = online_reference.transition(x, row, R_va, Tuning())
    step = 1e-5
    for j in range(N_STATES):
        shift = step * np.eye(N_STATES)[j]
        slope = (following(x + shift) - following(x - shift)) / (2.0 * step)
        np.testing.assert_allclose(slope, jacobian[:, j], atol=1e-7)


def test_turning_the_reference_is_turning_the_state(monkeypatch: pytest.MonkeyPatch):
    # The derivative to the mounting: a turned reference drives speed, climb and track as the state TURN does.
    drive, _ = drive_of("urban", 60.0, 7)
    start, rows = captured_rows(drive, monkeypatch)
    from nav_core.rotation import rotvec_to_matrix

    row, R_va, x = rows[100], start.R_va[3], start.x[3]
    for axis in range(3):
        turn = 1e-5 * np.eye(3)[axis]
        state = x.copy()
        state[TURN : TURN + 3] = turn
        F, u, _ = online_reference.transition(state, row, R_va, Tuning())
        G, v, _ = online_reference.transition(x, row, rotvec_to_matrix(turn) @ R_va, Tuning())
        moving = [0, 1, 7]
        np.testing.assert_allclose((F @ state + u)[moving], (G @ x + v)[moving], atol=1e-8)


def test_chunks_may_be_cut_anywhere():
    drive, _ = drive_of("urban", 60.0, 7)
    states = [run_through(drive, stride)[-1] for stride in (5.0, 7.3, 1.1)]
    for other in states[1:]:
        assert angle_between(mounting_of(states[0].filters), mounting_of(other.filters)) < np.radians(0.02)
        np.testing.assert_allclose(
            covariance_of(states[0].filters, states[0].tally), covariance_of(other.filters, other.tally), rtol=0.02
        )


def test_a_state_is_not_changed_by_what_follows():
    drive, _ = drive_of("urban", 60.0, 7)
    chunks = chunks_of(drive, 10.0)
    state = begin()
    for chunk in chunks[:3]:
        state = advance(state, chunk)
    before = [column.copy() for column in state.filters]
    once, again = advance(state, chunks[3]), advance(state, chunks[3])
    for kept, column in zip(before, state.filters, strict=True):
        np.testing.assert_array_equal(kept, column)
    np.testing.assert_array_equal(once.filters.P, again.filters.P)


def test_what_was_sent_twice_counts_once():
    drive, _ = drive_of("urban", 60.0, 7)
    chunks = chunks_of(drive, 10.0)
    once = begin()
    for chunk in chunks:
        once = advance(once, chunk)
    gnss = joined(chunks[3].gnss, chunks[3].gnss)
    assert gnss.t.size == chunks[3].gnss.t.size
    twice = advance(once, replace(chunks[3], ticks=replace_nothing(chunks[3])))
    np.testing.assert_array_equal(once.filters.P, twice.filters.P)


def replace_nothing(chunk: Chunk):
    kept = np.zeros(chunk.ticks.index.size, dtype=bool)
    ticks = chunk.ticks
    return type(ticks)(ticks.rate, ticks.index[kept], ticks.weight[kept], ticks.moment[kept], ticks.square[kept])


def test_a_fleet_is_its_boxes():
    drives = [drive_of("urban", 60.0, 7)[0], drive_of("roundabout", 60.0, 8)[0]]
    alone = [run_through(drive, 10.0)[-1] for drive in drives]
    states = [begin(), begin()]
    for pair in zip(*(chunks_of(drive, 10.0) for drive in drives), strict=True):
        states = advance_fleet(states, pair)
    for one, other in zip(alone, states, strict=True):
        np.testing.assert_allclose(one.filters.x, other.filters.x, atol=1e-12)
    with pytest.raises(ShapeError):
        advance_fleet(states, [])


def test_the_start_knows_nothing_of_yaw():
    drive, truth = drive_of("urban", 60.0, 7)
    states = run_through(drive, 5.0)
    first = next(state for state in states if state.filters is not None)
    assert 2 < len(first.filters.x) <= 2 * HYPOTHESES
    last = states[-1].filters
    assert not last.mirrored.any()
    assert len(last.x) == 1
    assert angle_between(mounting_of(last), truth.R_va) < np.radians(5.0)


def test_stack_copies():
    drive, _ = drive_of("urban", 60.0, 7)
    state = run_through(drive, 10.0)[-1]
    stacked, first, last, rows = stack([state.filters, state.filters], [np.zeros((2, 30)), np.zeros((3, 30))])
    stacked.x[:] = 1.0
    assert not np.any(state.filters.x == 1.0)
    assert first.tolist() == [0, 2]
    assert last.tolist() == [2, 5]
    assert rows.shape == (5, 30)


def end_of(drive: Drive):
    return assess(run_through(drive, 30.0)[-1])


# route, seconds, bar of the median time to 2° for good (reference: first motion, all axes, error and sigma), s
CONVERGENCE = [("roundabout", 120.0, 45.0), ("urban", 240.0, 60.0), ("highway", 300.0, 150.0)]


@pytest.mark.slow
@pytest.mark.parametrize(("route", "duration", "bar"), CONVERGENCE)
def test_convergence(route: str, duration: float, bar: float):
    times, errors, scaled = [], [], []
    for seed in range(600, 615):
        drive, truth = simulate(Scenario(route=route, duration=duration), seed=seed)  # type: ignore[arg-type]
        good_since, state = np.inf, begin()
        for chunk in chunks_of(drive, 5.0):
            state = advance(state, chunk)
            if state.filters is None:
                continue
            sigma = np.sqrt(np.diag(covariance_of(state.filters, state.tally)))
            error = error_between(mounting_of(state.filters), truth.R_va)
            if max(np.abs(error).max(), sigma.max()) < np.radians(2.0):
                good_since = min(good_since, state.tally.driven)
            else:
                good_since = np.inf
        times.append(good_since)
        errors.append(np.degrees(np.linalg.norm(error)))
        scaled.append(error / sigma)
    assert np.median(times) <= bar
    assert np.median(errors) < 1.2
    assert max(errors) < 4.0
    assert np.abs(scaled).max() < 4.0
    assert (np.abs(scaled) < 1.96).mean() > 0.85


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_other_receivers_and_what_a_good_estimate_says_of_itself(rate: float):
    drive, truth = drive_of("urban", 240.0, 21, False, rate)
    found = end_of(drive)
    assert found.status == "ready"
    assert found.reasons == ()
    assert found.stable
    assert found.reliable
    assert found.progress == 1.0
    assert 0.0 < found.observability < 1.0
    assert found.converged_after is not None
    assert found.sigma.max() < np.radians(2.0)
    assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)
    assert found.speed_lag == pytest.approx(truth.speed_lag, abs=0.1)
    assert found.course_lag == pytest.approx(truth.course_lag, abs=0.15)


def test_a_gyro_makes_it_quicker():
    without, _ = drive_of("urban", 120.0, 33)
    with_gyro, truth = drive_of("urban", 120.0, 33, True)
    slow, quick = end_of(without), end_of(with_gyro)
    assert quick.sigma[2] < slow.sigma[2]
    assert np.all(np.abs(error_between(quick.R_va, truth.R_va)) < 3.0 * quick.sigma)


def test_progress_and_reasons_on_the_way():
    drive, _ = drive_of("gentle", 120.0, 5)
    states = run_through(drive, 10.0)
    found = [assess(state) for state in states]
    assert found[0].status == "insufficient"
    assert {reason.code for reason in found[0].reasons} == {"not_driven"}
    assert all((each.status == "ready") == (not each.reasons) for each in found)
    assert found[-1].status == "ready"
    progress = [each.progress for each in found]
    assert progress[-1] > progress[1]
    assert assess(begin()).reasons[0].code == "no_fix"
    early = advance(begin(), chunks_of(drive, 4.0)[0])
    assert assess(early).reasons[0].code == "few_fixes"


def test_a_standing_car_is_never_ready():
    drive, _ = drive_of("static", 120.0, 3)
    assert all(assess(state).status == "insufficient" for state in run_through(drive, 30.0))


def with_force(drive: Drive, f: np.ndarray) -> Drive:
    return Drive(Inertial(drive.inertial.t, f), drive.gnss)


@pytest.mark.parametrize(
    ("mangle", "code"),
    [(-np.eye(3), "mirrored"), (np.diag([1.0, 1.0, -1.0]), "mirrored"), (np.eye(3) / 9.80665, "wrong_unit")],
)
def test_inverted_left_handed_and_in_another_unit(mangle: np.ndarray, code: str):
    drive, _ = drive_of("urban", 240.0, 21)
    found = end_of(with_force(drive, drive.inertial.f @ mangle))
    assert found.status == "insufficient"
    assert code in {reason.code for reason in found.reasons}


def test_signs_that_no_bend_has_told_of():
    """On a straight road they are taken on trust after a while, and that is said; without a course never."""
    straight, _ = drive_of("straight", 300.0, 5)
    for drive in (straight, with_force(straight, -straight.inertial.f)):
        early, late = (assess(states[-1]) for states in (run_through(cut(drive, 120.0)), run_through(drive)))
        assert early.status != "ready"
        assert late.status == "ready"
        assert {reason.code for reason in late.reasons} == {"handedness_trusted"}
    town, truth = drive_of("urban", 240.0, 21)
    blind = replace(town, gnss=replace(town.gnss, course=np.full(town.gnss.t.size, np.nan)))
    found = end_of(blind)
    assert found.status == "settling"
    assert "no_course" in {reason.code for reason in found.reasons}
    assert np.degrees(angle_between(found.R_va, truth.R_va)) < 8.0


def cut(drive: Drive, until: float) -> Drive:
    felt, fixes = drive.inertial.t < until, drive.gnss.t < until
    columns = [getattr(drive.gnss, name)[fixes] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")]
    return Drive(Inertial(drive.inertial.t[felt], drive.inertial.f[felt]), Gnss(*columns))


@pytest.mark.parametrize("rate", [1.0, 4.0])
@pytest.mark.parametrize("first", [True, False], ids=["out of the parking place", "on the way"])
def test_reversing_is_not_taken_for_driving(first: bool, rate: float):
    """The receiver's speed and course are the same both ways."""
    for seed in range(31, 34):
        drive, truth = drive_of("urban", 240.0, seed, False, rate)
        still = np.flatnonzero((truth.v < 0.01) & (truth.t > (1.0 if first else 60.0)))
        at = float(truth.t[still[0]]) + 0.5
        found = end_of(fault.backing_up(drive, truth.R_va, at, seed=seed, lasting=10.0))
        assert found.status == "ready"
        assert found.changes == ()
        assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.5 * found.sigma)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_box_that_is_tilted_far_is_not_called_ready_for_long(axis: int):
    """The first seconds after it startle the filter, whenever the second one last forgot."""
    for seed, at in ((3, 260.0), (4, 330.0), (5, 395.0)):
        _, before = simulate(Scenario(duration=20.0), seed=seed)
        turn = np.radians(20.0) * before.R_va.T[:, axis]
        scenario = Scenario(duration=at + 100.0, accel_rate=50.0, moves=(Move(t=at, turn=tuple(turn)),))
        drive, truth = simulate(scenario, seed=seed)
        wrong, state, said = 0.0, begin(), set()
        for chunk in chunks_of(drive, 5.0):
            state = advance(state, chunk)
            found = assess(state)
            said |= {reason.code for reason in found.reasons}
            if found.status == "ready" and state.gnss.t[-1] > at + 1.0:
                wrong += 5.0 * (angle_between(found.R_va, truth.R_va) > np.radians(10.0))
        assert "startled" in said or found.changes
        assert wrong <= 15.0


def moved_drive(axis: int, degrees: float, seed: int) -> tuple[Drive, Truth]:
    """Turned about a V axis at 450 s of 900 s in town."""
    _, before = simulate(Scenario(duration=20.0), seed=seed)
    turn = np.radians(degrees) * before.R_va.T[:, axis]
    scenario = Scenario(duration=900.0, accel_rate=50.0, moves=(Move(t=450.0, turn=tuple(turn)),))
    return simulate(scenario, seed=seed)


@pytest.mark.parametrize(("axis", "degrees"), [(2, 6.0), (0, 6.0), (1, 6.0), (0, 35.0), (2, 180.0)])
def test_a_moved_box_is_found_out_and_learnt_anew(axis: int, degrees: float):
    drive, truth = moved_drive(axis, degrees, 3)
    mixed, state = 0.0, begin()
    for chunk in chunks_of(drive, 5.0):
        state = advance(state, chunk)
        found = assess(state)
        if found.status == "ready" and state.gnss.t[-1] > 450.0:
            mixed += 5.0 * (angle_between(found.R_va, truth.R_va) > np.radians(3.0))
    assert found.status == "ready"
    (change,) = found.changes
    assert 380.0 < change.t < 560.0
    assert np.degrees(change.angle) == pytest.approx(degrees, abs=2.0)
    assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)
    assert mixed <= 90.0


@pytest.mark.parametrize("route", ["urban", "highway", "gentle", "straight"])
def test_a_box_that_stays_put_raises_no_alarm(route: str):
    drive, truth = drive_of(route, 900.0, 1, False, 4.0)
    states = run_through(drive, 60.0)
    assert not any(state.moves or state.watch.suspicious for state in states)
    found = assess(states[-1])
    assert found.changes == ()
    assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)


def in_another_clock(gnss: Gnss, by: float, *, utc: bool) -> Gnss:
    columns = [getattr(gnss, name) for name in ("lat", "lon", "alt", "speed", "course", "fix")]
    return Gnss(gnss.t + by, *columns, utc=1.7e9 + gnss.t if utc else None)


@pytest.mark.parametrize("utc", [True, False])
def test_a_clock_that_jumps_back_begins_anew(utc: bool):
    drive, truth = drive_of("urban", 240.0, 21)
    state = begin()
    for shift, since, until in ((0.0, 0.0, 120.0), (-100.0, 120.0, 240.0)):
        samples = (drive.inertial.t >= since) & (drive.inertial.t < until)
        fixes = (drive.gnss.t >= since) & (drive.gnss.t < until)
        columns = [getattr(drive.gnss, name)[fixes] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")]
        gnss = in_another_clock(Gnss(*columns), shift, utc=utc)
        part = Drive(Inertial(drive.inertial.t[samples] + shift, drive.inertial.f[samples]), gnss)
        for chunk in chunks_of(part, 10.0):
            state = advance(state, chunk)
            if state.remarks and state.tally.driven < 20.0:
                assert assess(state).status != "ready"
    found = assess(state)
    assert {"clock_back"} <= {reason.code for reason in found.reasons}
    assert state.tally.driven == pytest.approx(120.0, abs=10.0)
    assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)


def test_fixes_sent_again_are_no_jump():
    drive, _ = drive_of("urban", 60.0, 7)
    drive = Drive(drive.inertial, in_another_clock(drive.gnss, 0.0, utc=True))
    chunks = chunks_of(drive, 10.0)
    once = begin()
    for chunk in chunks:
        once = advance(once, chunk)
    again = advance(once, replace(chunks[2], ticks=replace_nothing(chunks[2])))
    assert again.remarks == ()
    np.testing.assert_array_equal(once.filters.P, again.filters.P)


@pytest.mark.parametrize("seed", range(3))
def test_a_box_that_wanders_in_its_holder_is_never_ready(seed: int):
    drive, _ = drive_of("urban", 240.0, 21)
    walk = np.cumsum(0.002 * np.random.default_rng(seed).standard_normal((drive.inertial.t.size, 3)), axis=0)
    turned = np.einsum("nij,nj->ni", Rotation.from_rotvec(walk).as_matrix(), drive.inertial.f)
    assert end_of(with_force(drive, turned)).status != "ready"


def test_holes_in_either_stream_are_lived_through():
    drive, truth = drive_of("urban", 240.0, 21)
    t = drive.inertial.t
    kept = (t < 60.0) | (t > 72.0)
    fixes = (drive.gnss.t < 100.0) | (drive.gnss.t > 130.0)
    columns = [getattr(drive.gnss, name)[fixes] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix")]
    found = end_of(Drive(Inertial(t[kept], drive.inertial.f[kept]), Gnss(*columns)))
    assert found.status == "ready"
    assert np.all(np.abs(error_between(found.R_va, truth.R_va)) < 3.0 * found.sigma)


def test_without_one_of_the_streams():
    drive, _ = drive_of("urban", 60.0, 7)
    none = np.zeros(0, dtype=bool)
    columns = [getattr(drive.gnss, name)[none] for name in ("t", "lat", "lon", "alt", "speed", "course")]
    no_fix = Drive(drive.inertial, Gnss(*columns, np.zeros(0, dtype=bool)))
    assert end_of(no_fix).reasons[0].code == "no_fix"
    deaf = Drive(Inertial(drive.inertial.t[:0], drive.inertial.f[:0]), drive.gnss)
    assert end_of(deaf).status == "insufficient"


def test_by_name():
    drive, truth = drive_of("urban", 240.0, 21)
    found = estimate_mounting(drive, method="online")
    assert found.method == "online"
    assert angle_between(found.R_va, truth.R_va) < np.radians(3.0)


def test_many_boxes_in_one_call():
    drive, _ = drive_of("urban", 60.0, 7)
    state = run_through(drive, 10.0)[-1]
    rows = np.tile(np.zeros(30), (64, 1))
    many, first, last, stacked = stack([state.filters] * 64, list(rows[:, None, :]))
    run(many, stacked, first, last, Tuning(), np.zeros((0, 4)))
    np.testing.assert_array_equal(many.x, np.tile(many.x[0], (64, 1)))
