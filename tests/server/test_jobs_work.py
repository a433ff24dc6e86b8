from __future__ import annotations

import datetime as dt
import threading

import numpy as np
import pytest
import sqlalchemy as sa
from fleet_world import Leg, World, cut, drive_of
from sqlalchemy import select

from server.database import Database
from server.events import queries as event_queries
from server.formats.columns import Columns
from server.jobs import situation as reads
from server.jobs.due import due_devices
from server.jobs.mountings import ALGORITHM
from server.jobs.work import QUIET_S, Round, bring_up_to_date, read_batch
from server.models import (
    Assignment,
    Batch,
    BatchDigest,
    Boot,
    Change,
    Device,
    DeviceState,
    Installation,
    MountingRevision,
    TrackPoint,
    Trip,
    Vehicle,
)

UTC0 = 1_772_366_400.0
both = pytest.mark.both_databases
CITY = (Leg(20, 0.0), Leg(150, 10.0), Leg(60, 0.0), Leg(60, 15.0), Leg(10, 0.0))


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


def put_all(world, batches, order=None, **options) -> None:
    for k in range(len(batches)) if order is None else order:
        world.put(batches[k], k, **options)


def final_state(world) -> dict:
    """What must not depend on the order in which the batches came."""
    boots = {b.boot: (b.utc_offset_s, b.utc_drift, b.t_first_s, b.t_last_s) for b in world.rows(Boot)}
    installations = [
        (i.beginning, i.began_at, i.ended_at, i.status, i.result, i.input_sha256, i.unestimated_s)
        for i in world.rows(Installation, Installation.began_at)
    ]
    trips = [
        (t.boot, t.t_first_s, t.t_last_s, t.distance_m, t.position_distance_m, t.moving_s, t.under_way, t.input_sha256)
        for t in world.rows(Trip, Trip.began_at)
    ]
    points = [(p.t_s, p.lat_deg, p.speed_mps) for p in world.rows(TrackPoint, TrackPoint.trip_id, TrackPoint.t_s)]
    state = world.one(DeviceState)
    return {
        "boots": boots,
        "installations": installations,
        "trips": trips,
        "points": sorted(points),
        "position": (state.position_at, state.lat_deg),
    }


@both
def test_a_first_batch_appears_everywhere(world):
    world.put(cut(drive_of(*CITY))[2], 2)
    outcome = world.bring_up()
    assert (outcome.batches, outcome.failed, outcome.more) == (1, 0, False)
    assert world.one(Batch).processed_at == world.clock()
    assert world.one(BatchDigest).clock_offset_s == pytest.approx(UTC0)
    boot = world.one(Boot)
    assert boot.utc_source == "gnss"
    assert boot.unix_s(20.0) == pytest.approx(UTC0 + 20.0, abs=1e-3)
    installation = world.one(Installation)
    assert (installation.beginning, installation.status) == ("first", "settling")
    assert installation.began_at.timestamp() == pytest.approx(UTC0 + 20.0, abs=0.01)
    assert installation.algorithm == ALGORITHM
    assert len(installation.input_sha256) == 64
    state = world.one(DeviceState)
    assert state.lat_deg == pytest.approx(45.0, abs=0.01)
    assert state.speed_mps == 10.0
    assert state.health["rate_hz"] == pytest.approx(20.0)
    assert state.health["gnss_rate_hz"] == pytest.approx(2.0)
    trip = world.one(Trip)
    assert trip.under_way
    assert world.kinds()[1:] == ["batch", "position", "trip", "installation"]


@both
def test_nothing_due_is_nothing_done(world):
    assert world.bring_up() == type(world.bring_up())()
    assert world.bring_up("f" * 32).batches == 0
    world.put(cut(drive_of(*CITY))[0], 0)
    world.bring_up()
    version = world.one(DeviceState).version
    assert world.bring_up().batches == 0
    assert world.one(DeviceState).version == version


def test_any_order_of_arrival_gives_the_same(world, database, settings, clock, organisation):
    batches = cut(drive_of(*CITY), seconds=20.0)
    shuffled = np.random.default_rng(3).permutation(len(batches)).tolist()
    orders = {"in order, one by one": list(range(len(batches))), "shuffled": shuffled, "backwards": shuffled[::-1]}
    states = {}
    put_all(world, batches)
    world.settle()
    states["all at once"] = final_state(world)
    for name, order in orders.items():
        wipe(database)
        again = World(database, settings, clock, organisation)
        for k in order:
            again.put(batches[k], k)
            again.bring_up()
        again.settle()
        states[name] = final_state(again)
    first = states.pop("all at once")
    for state in states.values():
        assert state == first


def wipe(database):
    with database.transaction() as session:
        for model in (
            TrackPoint,
            Trip,
            MountingRevision,
            Installation,
            BatchDigest,
            Batch,
            Boot,
            DeviceState,
            Assignment,
            Device,
        ):
            session.query(model).delete()


def test_several_boots_follow_one_another_whichever_comes_first(world, database, settings, clock, organisation):
    morning = cut(drive_of(Leg(100, 10.0)))
    evening = cut(drive_of(Leg(100, 12.0), start=5.0, utc=UTC0 + 30_000.0))
    put_all(world, morning, boot="a")
    put_all(world, evening, boot="b")
    world.settle()
    in_order = final_state(world)
    assert [trip[0] for trip in in_order["trips"]] == ["a", "b"]
    assert len(in_order["installations"]) == 1
    wipe(database)
    again = World(database, settings, clock, organisation)
    put_all(again, evening, boot="b")
    again.bring_up()
    put_all(again, morning, boot="a")
    again.settle()
    assert final_state(again) == in_order


@both
def test_a_moved_box_begins_a_new_installation(world):
    drive = drive_of(Leg(120, 10.0), Leg(120, 10.0, down=-1.0))
    for k, batch in enumerate(cut(drive)):
        world.put(batch, k)
        world.bring_up()
    world.settle()
    before, after = world.rows(Installation, Installation.began_at)
    assert (before.beginning, after.beginning) == ("first", "moved")
    assert before.ended_at == after.began_at
    assert after.began_at.timestamp() == pytest.approx(UTC0 + 120.0, abs=1.0)
    assert after.ended_at is None
    assert after.moved_angle_rad == pytest.approx(np.pi)
    assert before.status == after.status == "ready"
    assert np.allclose(before.result["R_va"], np.eye(3))
    assert np.allclose(after.result["R_va"], np.diag([1.0, -1.0, -1.0]))
    assert world.kinds().count("moved") == 1


def test_a_batch_that_comes_late_improves_the_installation_it_belongs_to(world):
    batches = cut(drive_of(Leg(120, 10.0), Leg(120, 10.0, down=-1.0)))
    put_all(world, batches, order=[k for k in range(len(batches)) if k != 3])
    world.settle()
    before, after = world.rows(Installation, Installation.began_at)
    world.put(batches[3], 3)
    world.settle()
    before_again, after_again = world.rows(Installation, Installation.began_at)
    assert before_again.input_sha256 != before.input_sha256
    assert (after_again.id, after_again.result) == (after.id, after.result)
    assert before_again.ended_at == before.ended_at


def test_a_measured_mounting_stays_until_the_box_moves(world, clock):
    clock.now = dt.datetime.fromtimestamp(UTC0 + 30.0, dt.UTC)
    batches = cut(drive_of(Leg(120, 10.0), Leg(120, 10.0, down=-1.0)))
    put_all(world, batches[:3])
    world.bring_up()
    from server.installations.service import set_manual

    with world.database.transaction() as session:
        set_manual(
            session,
            world.organisation.id,
            world.device_id,
            [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            reason="measured",
            sigma_deg=None,
            since=clock(),
            now=clock(),
        )
    put_all(world, batches, order=range(3, 12))
    world.settle()
    first, manual = world.rows(Installation, Installation.began_at)
    assert first.ended_at == manual.began_at
    assert (manual.beginning, manual.result["method"], manual.result["R_va"][0]) == (
        "manual",
        "manual",
        [0.0, 1.0, 0.0],
    )
    assert [r for r in world.rows(MountingRevision) if r.installation_id == manual.id]
    put_all(world, batches, order=range(12, 24))
    world.settle()
    _, manual, moved = world.rows(Installation, Installation.began_at)
    assert manual.result["method"] == "manual"
    assert manual.ended_at == moved.began_at
    assert moved.beginning == "moved"
    assert moved.result["method"] == "whole-drive"


def test_a_swap_ends_the_installation_and_data_after_it_count_for_the_new_vehicle(world, clock):
    from server.devices.service import put_into_vehicle

    with world.database.transaction() as session:
        cars = [Vehicle(organisation_id=world.organisation.id, name=name, created_at=clock()) for name in "ab"]
        session.add_all(cars)
    world.device_id = world.new_device(cars[0].id)
    clock.now = dt.datetime.fromtimestamp(UTC0 + 400.0, dt.UTC)
    batches = cut(drive_of(Leg(100, 10.0), Leg(300, 0.0), Leg(200, 10.0)))
    put_all(world, batches[:45])
    world.settle()
    swapped_at = dt.datetime.fromtimestamp(UTC0 + 250.0, dt.UTC)
    with world.database.transaction() as session:
        put_into_vehicle(session, world.organisation.id, world.device_id, cars[1].id, at=swapped_at, now=clock())
    world.settle()
    put_all(world, batches, order=range(45, len(batches)))
    world.settle()
    old, new = world.rows(Installation, Installation.began_at)
    assert (old.vehicle_id, old.ended_at, old.beginning) == (cars[0].id, swapped_at, "first")
    assert (new.vehicle_id, new.began_at, new.beginning) == (cars[1].id, swapped_at, "swapped")
    assert new.status == "ready"
    assert [trip.vehicle_id for trip in world.rows(Trip, Trip.began_at)] == [cars[0].id, cars[1].id]


@both
@pytest.mark.parametrize("blob_sha256", [None, "0" * 64])
def test_a_blob_that_other_bytes_make_up_is_told_whole_by_its_columns(world, blob_sha256):
    """A batch from before blobs were hashed, and one whose blob an equal batch has written anew since."""
    batch_id = world.put(cut(drive_of(*CITY))[0], 0)
    with world.database.transaction() as session:
        session.get_one(Batch, batch_id).blob_sha256 = blob_sha256
    world.bring_up()
    assert world.one(Batch).failure is None


@both
@pytest.mark.parametrize("damage", ["missing", "garbage", "other"])
def test_a_batch_that_cannot_be_read_is_remarked_and_stops_nobody(world, damage):
    batches = cut(drive_of(*CITY))
    put_all(world, batches[:3])
    key = next(batch.blob_key for batch in world.rows(Batch) if batch.sequence == 1)
    path = world.store._root / key
    content = path.read_bytes()
    path.unlink()
    if damage != "missing":
        values = {**batches[1].values, "alt": batches[1].values["alt"] + 1.0}
        path.write_bytes(content[:-50] if damage == "garbage" else Columns(values).to_parquet())
    assert world.bring_up().failed == 1
    failed = next(batch for batch in world.rows(Batch) if batch.sequence == 1)
    assert failed.processed_at is not None
    assert failed.failure
    assert failed.remarks[-1]["code"] == "unreadable"
    assert world.one(DeviceState).health["unreadable_batches"] == 1
    assert len(world.rows(BatchDigest)) == 2


def test_a_store_that_does_not_answer_leaves_the_batches_due(world):
    world.put(cut(drive_of(*CITY))[0], 0)

    class Down:
        def get(self, key):
            raise OSError(f"no route to {key}")

    with pytest.raises(OSError, match="no route"):
        bring_up_to_date(world.database, Down(), world.device_id, clock=world.clock, estimator=world.estimator)
    assert world.unprocessed() == 1
    assert world.bring_up().batches == 1


def test_a_batch_without_accelerations_or_without_fixes_is_taken(world):
    full = cut(drive_of(*CITY))
    fixes = {name: column for name, column in full[3].values.items() if not name.startswith("f") or name == "fix"}
    keep = ~np.isnan(fixes["fix"])
    world.put(Columns({name: column[keep] for name, column in fixes.items()}), 0)
    assert world.bring_up().failed == 0
    force = {name: full[4].values[name] for name in ("t", "fx", "fy", "fz")}
    world.put(Columns(force), 1)
    assert world.bring_up().failed == 0
    assert world.rows(Installation)


def test_an_estimator_that_fails_does_not_keep_the_batches(world):
    def broken(_ticks, _gnss, _past, _noise):
        raise np.linalg.LinAlgError("singular")

    world.estimator = broken
    put_all(world, cut(drive_of(*CITY))[:3])
    assert world.bring_up().batches == 3
    assert world.one(Installation).status == "insufficient"
    assert world.unprocessed() == 0


@both
def test_killed_before_the_write_loses_nothing_and_does_nothing_twice(world, monkeypatch):
    put_all(world, cut(drive_of(*CITY))[:4])

    def dies(_round):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Round, "write", dies)
        with pytest.raises(KeyboardInterrupt):
            world.bring_up()
    assert world.unprocessed() == 4
    assert not world.rows(Installation)
    real = Round._store

    def dies_inside(self, session):
        real(self, session)
        session.flush()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Round, "_store", dies_inside)
        with pytest.raises(KeyboardInterrupt):
            world.bring_up()
    assert world.unprocessed() == 4
    assert not world.rows(Installation)
    assert "installation" not in world.kinds()
    assert world.bring_up().batches == 4
    assert len(world.rows(BatchDigest)) == 4
    assert len(world.rows(Installation)) == 1


def computed(world) -> Round:
    with world.database.reading() as session:
        situation = reads.read_situation(session, world.device_id, 64)
    work = Round(world.database, world.store, situation, world.clock(), world.estimator, world.reconstructor)
    work.compute({batch.id: read_batch(world.store, batch) for batch in situation.batches})
    return work


@both
@pytest.mark.parametrize("known", [False, True])
def test_of_two_rounds_from_the_same_version_one_writes(world, known):
    batches = cut(drive_of(*CITY))
    if known:
        world.put(batches[0], 0)
        world.bring_up()
    put_all(world, batches, order=range(1, 4))
    first, second = computed(world), computed(world)
    assert first.write()
    assert not second.write()
    assert len(world.rows(BatchDigest)) == 3 + known
    assert len(world.rows(Installation)) == 1
    assert world.kinds().count("position") == 1 + known


@both
def test_workers_that_race_do_nothing_twice(world, settings):
    batches = cut(drive_of(*CITY))
    put_all(world, batches)
    failures = []

    def work():
        database = Database(settings)
        try:
            for _ in range(6):
                bring_up_to_date(database, world.store, world.device_id, clock=world.clock, estimator=world.estimator)
        except Exception as error:  # noqa: BLE001  shown by the assertion below
            failures.append(error)
        finally:
            database.dispose()

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert world.unprocessed() == 0
    assert len(world.rows(BatchDigest)) == len(batches)
    assert len(world.rows(Installation)) == 1
    assert world.kinds().count("position") == world.one(DeviceState).version


def test_a_manual_change_meanwhile_makes_the_round_start_over(world, clock):
    from server.installations.service import set_manual

    clock.now = dt.datetime.fromtimestamp(UTC0 + 500.0, dt.UTC)
    batches = cut(drive_of(*CITY))
    world.put(batches[0], 0)
    world.bring_up()
    world.put(batches[1], 1)
    work = computed(world)
    with world.database.transaction() as session:
        set_manual(
            session, world.organisation.id, world.device_id, np.eye(3).tolist(),
            reason="by hand", sigma_deg=None, since=clock(), now=clock(),
        )  # fmt: skip
    assert not work.write()
    assert world.bring_up().batches == 1


def test_without_utc_the_time_of_arrival_stands_in(world, clock):
    batches = cut(drive_of(*CITY, utc=None))
    clock.now += dt.timedelta(seconds=100.0)
    world.put(batches[0], 0)
    clock.now += dt.timedelta(seconds=12.0)
    world.put(batches[1], 1)
    world.bring_up()
    boot = world.one(Boot)
    assert boot.utc_source == "arrival"
    assert boot.utc(batches[0].values["t"][-1]) == clock() - dt.timedelta(seconds=12.0)
    assert boot.utc_sigma_s >= 10.0
    assert "utc_from_arrival" in world.one(DeviceState).health["remarks"]
    # UTC comes with a later fix: what was laid out by arrival is laid out anew
    put_all(world, cut(drive_of(*CITY)), order=range(2, 10))
    world.settle()
    assert world.one(Boot).utc_source == "gnss"
    installation, trip = world.one(Installation), world.one(Trip)
    assert installation.began_at.timestamp() == pytest.approx(UTC0, abs=0.01)
    assert trip.began_at.timestamp() == pytest.approx(UTC0 + 20.0, abs=1.1)


def test_estimates_come_at_a_cadence_and_the_rest_when_the_box_is_silent(world, clock):
    runs = []

    def counted(ticks, gnss, past, noise):
        runs.append(ticks.t[-1])
        return world_estimator(ticks, gnss, past, noise)

    world_estimator, world.estimator = world.estimator, counted
    for k, batch in enumerate(cut(drive_of(Leg(305, 10.0)))):
        world.put(batch, k)
        clock.advance(seconds=10.0)
        world.bring_up()
    assert 6 <= len(runs) <= 10
    assert world.one(Installation).unestimated_s > 0.0
    with world.database.reading() as session:
        assert due_devices(session, 10, now=clock()) == []
        assert due_devices(session, 10, now=clock() + dt.timedelta(seconds=2 * QUIET_S)) == [world.device_id]
    clock.advance(seconds=2 * QUIET_S)
    world.bring_up()
    assert runs[-1] == pytest.approx(305.0, abs=0.3)
    assert world.one(Installation).unestimated_s == 0.0
    assert world.one(Trip).under_way
    clock.advance(seconds=300.0)
    world.bring_up()
    assert not world.one(Trip).under_way
    assert world.one(DeviceState).review_at is None


@pytest.mark.parametrize("late_s", [239.0, 240.0])
def test_a_backlog_is_under_way_only_as_long_as_its_newest_data_are_young(world, clock, late_s):
    end = dt.datetime.fromtimestamp(UTC0 + 119.95, dt.UTC)
    clock.now = end + dt.timedelta(seconds=late_s)
    put_all(world, cut(drive_of(Leg(120, 10.0))))
    world.bring_up()
    assert world.one(Trip).under_way == (late_s < 240.0)
    clock.now = end + dt.timedelta(seconds=240.0)
    world.bring_up()
    assert not world.one(Trip).under_way
    world.settle()
    assert world.one(DeviceState).review_at is None
    assert [change.data["trip_id"] for change in world.rows(Change) if change.kind == "trip"] == (
        [world.one(Trip).id] * (2 if late_s < 240.0 else 1)
    )


def test_a_trip_goes_on_after_a_backlog_that_had_ended_it(world, clock):
    batches = cut(drive_of(Leg(120, 10.0), Leg(60, 12.0)))
    clock.now = dt.datetime.fromtimestamp(UTC0 + 500.0, dt.UTC)
    put_all(world, batches[:12])
    world.bring_up()
    ended = world.one(Trip)
    assert not ended.under_way
    clock.now = dt.datetime.fromtimestamp(UTC0 + 190.0, dt.UTC)
    put_all(world, batches, order=range(12, 18))
    world.bring_up()
    going_on = world.one(Trip)
    assert (going_on.id, going_on.under_way) == (ended.id, True)
    assert going_on.distance_m > ended.distance_m


@pytest.mark.parametrize("fixes", [True, False])
def test_a_vehicle_that_stands_is_not_under_way_although_its_box_goes_on_sending(world, clock, fixes):
    for k, batch in enumerate(cut(drive_of(Leg(60, 10.0), Leg(260, 0.0)))):
        force = {name: batch.values[name][np.isfinite(batch.values["fx"])] for name in ("t", "fx", "fy", "fz")}
        world.put(batch if fixes or k < 6 else Columns(force), k)
        clock.now = dt.datetime.fromtimestamp(UTC0 + 10.0 * (k + 1), dt.UTC)
        world.bring_up()
        if k == 28:
            assert world.one(Trip).under_way
    trip = world.one(Trip)
    assert not trip.under_way
    assert trip.t_last_s == pytest.approx(60.0, abs=1.0)


def test_bursts_are_marked_and_kept(world):
    world.put(cut(drive_of(*CITY))[0], 0, stream="burst")
    assert world.bring_up().batches == 1
    assert world.one(Batch).processed_at is not None
    assert not world.rows(BatchDigest)
    assert not world.rows(Installation)


def test_a_long_backlog_is_worked_off_in_rounds(world):
    batches = cut(drive_of(Leg(700, 10.0), gnss_rate=1.0), seconds=10.0)
    put_all(world, batches)
    outcome = world.bring_up()
    assert (outcome.batches, outcome.more) == (64, True)
    assert world.bring_up().batches == len(batches) - 64


def test_large_batches_make_small_rounds(world, monkeypatch):
    """Whatever a box packs into a batch; one that alone is more than a round may have is worked off all the same."""
    batches = cut(drive_of(*CITY))[:5]
    monkeypatch.setattr(reads, "ROUND_ROWS", 2 * max(batch.rows for batch in batches))
    put_all(world, batches)
    outcomes = [world.bring_up() for _ in range(3)]
    assert [(outcome.batches, outcome.more) for outcome in outcomes] == [(2, True), (2, True), (1, False)]
    monkeypatch.setattr(reads, "ROUND_ROWS", 1)
    put_all(world, batches, boot="again")
    assert (world.bring_up().batches, world.unprocessed()) == (1, 4)


def test_of_many_batches_at_one_time_the_newest_are_read(world, monkeypatch):
    """A box whose clock begins anew without another name of the boot has ever more batches at every time."""
    batch = cut(drive_of(*CITY))[0]
    put_all(world, [batch] * 6)
    t = batch.values["t"]

    def around() -> list[int]:
        with world.database.reading() as session:
            return [
                each.sequence for each in event_queries.batches_between(session, world.device_id, "boot", t[0], t[-1])
            ]

    assert around() == [0, 1, 2, 3, 4, 5]
    monkeypatch.setattr(event_queries, "AROUND_ROWS", 3 * batch.rows)
    assert around() == [3, 4, 5]
    monkeypatch.setattr(event_queries, "AROUND_BATCHES", 2)
    assert around() == [4, 5]
    monkeypatch.setattr(event_queries, "AROUND_ROWS", 1)
    assert around() == [5]


def test_what_every_round_reads_grows_with_no_boxs_past(database):
    """SQLite chooses its indexes without figures of the tables, so an empty one tells."""
    asked: list[tuple[str, object]] = []
    with database.reading() as session:
        sa.event.listen(session.connection(), "before_cursor_execute", lambda *told: asked.append(told[2:4]))
        event_queries.batches_between(session, "box", "boot", 0.0, 1.0)
        reads.pieces_of_boot(session, "box", "boot", after_s=0.0, before_s=1.0, newest_s=1.0)
        around, newest = (
            [row.detail for row in session.connection().exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", values)]
            for statement, values in tuple(asked)
        )
    assert "ix_batch_clock (device_id=? AND boot=? AND t_last_s>?)" in around[0]
    assert "(device_id=? AND stream=? AND boot=?)" in newest[0]
    assert not any("ORDER BY" in step for step in newest)


def test_an_estimate_reads_no_more_than_its_window(world):
    spans = []

    def spanned(ticks, gnss, past, noise):
        spans.append(ticks.t[-1] - ticks.t[0])
        return world_estimator(ticks, gnss, past, noise)

    world_estimator, world.estimator = world.estimator, spanned
    for hour in range(3):
        put_all(world, cut(drive_of(Leg(3600, 10.0), rate=10.0, gnss_rate=1.0), seconds=600.0), boot=f"b{hour}")
    # three boots of the same hour: only their order and length matter here
    world.settle()
    assert max(spans) <= 7200.0 + 700.0
    assert world.one(Installation).status == "ready"


def test_due_goes_round_by_id(world):
    others = sorted([world.new_device() for _ in range(3)])
    batch = cut(drive_of(*CITY))[0]
    for device_id in others:
        world.put(batch, 0, device_id=device_id)
    with world.database.reading() as session:
        assert due_devices(session, 2, now=world.clock()) == others[:2]
        assert due_devices(session, 2, now=world.clock(), after=others[1]) == others[2:]
        assert session.scalar(select(Batch.id).where(Batch.processed_at.is_not(None))) is None
