"""Events out of batches: bursts first, context later, revisions kept, nothing twice."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from crash_world import Reconstructor, braking, crash
from fleet_world import Leg, World, cut, drive_of
from sqlalchemy import delete, select
from sqlalchemy.exc import IntegrityError

from nav_core.records import Drive, Inertial
from server import migrations
from server.events import queries
from server.events.canonical import canonical
from server.events.window import Part, merged
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.jobs.due import burst_devices
from server.jobs.events import event_document, run_inputs
from server.models import Batch, BatchDigest, DeviceState, Event, EventInput, EventRevision, Installation

both = pytest.mark.both_databases
DRIVE = (Leg(100, 12.0), Leg(60, 0.0))
T0 = 100.0


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.reconstructor = Reconstructor(crash(T0))
    return world


def burst(rate=200.0, around=T0) -> Columns:
    rng = np.random.default_rng(5)
    t = np.arange(around - 2.0, around + 2.0, 1.0 / rate)
    force = rng.normal(0.0, 0.1, (t.size, 3)) - [0.0, 0.0, 9.81]
    return from_drive(Drive(Inertial(t, force), drive_of(Leg(0.5, 0.0), gnss_rate=1.0, start=around).gnss))


def documents(world) -> list[dict]:
    return [queries.document(row) for row in world.rows(EventRevision, EventRevision.number)]


@both
def test_a_burst_makes_an_event_and_the_context_revises_it(world):
    world.put(burst(), 0, stream="burst")
    world.bring_up()
    first = world.one(Event)
    assert (first.kind, first.severe, first.revision) == ("crash", True, 1)
    assert first.at.timestamp() == pytest.approx(1_772_366_500.0, abs=0.6)
    assert first.result["basis"]["mounting_status"] == "ready"
    assert world.kinds()[-2:] == ["event", "alert"]
    for k, batch in enumerate(cut(drive_of(*DRIVE), seconds=20.0)):
        world.put(batch, k)
        world.bring_up()
    event = world.one(Event)
    assert event.id == first.id
    rows = world.rows(EventRevision, EventRevision.number)
    # 40 s before to 35 s after: batches 3..6 of 20 s reach into it.
    assert [row.number for row in rows] == list(range(1, event.revision + 1))
    assert event.revision == 5
    shown = [len(document["inputs"]["batches"]) for document in documents(world)]
    assert shown == [1, 2, 3, 4, 5]
    for row in rows:
        content = queries.canonical_bytes(row)
        assert hashlib.sha256(content).hexdigest() == row.event_sha256
        assert canonical(queries.document(row)) == content
    assert len(world.rows(EventInput)) == 5


@both
def test_computing_again_from_the_named_inputs_gives_the_same_bytes(world):
    world.put(burst(), 0, stream="burst")
    for k, batch in enumerate(cut(drive_of(*DRIVE), seconds=20.0)):
        world.put(batch, k)
    while world.bring_up().more:
        pass
    row = world.rows(EventRevision, EventRevision.number)[-1]
    document = queries.document(row)
    batches = {batch.chain_index: batch for batch in world.rows(Batch)}
    parts = [
        Part(Columns.from_parquet(world.store.get(batches[b["chain_index"]].blob_key)), b["stream"] == "burst")
        for b in document["inputs"]["batches"]
    ]
    inputs = {name: value for name, value in document["inputs"].items() if name != "sha256"}
    (event,) = run_inputs(inputs, parts, world.reconstructor)
    again = event_document(event, inputs, device_id=world.device_id, boot="boot")
    assert canonical(again) == queries.canonical_bytes(row)


def test_a_repeated_round_changes_nothing(world):
    for k, batch in enumerate(cut(drive_of(*DRIVE), seconds=40.0)):
        world.put(batch, k)
    world.bring_up()
    before = [(row.number, row.event_sha256) for row in world.rows(EventRevision, EventRevision.number)]
    with world.database.transaction() as session:
        for batch in session.query(Batch):
            batch.processed_at = None
    with world.database.transaction() as session:
        from server.models import BatchDigest

        session.execute(delete(BatchDigest))
    world.bring_up()
    assert [(row.number, row.event_sha256) for row in world.rows(EventRevision, EventRevision.number)] == before
    assert world.one(Event).revision == len(before)


def test_an_event_keeps_the_mounting_of_its_time(world):
    """The box is turned over 30 s after the crash; data after that do not reach into the event."""
    batches = cut(drive_of(Leg(100, 12.0), Leg(20, 0.0), Leg(200, 10.0, down=-1.0)), seconds=20.0)
    for k, batch in enumerate(batches):
        world.put(batch, k)
        world.bring_up()
    world.settle()
    for document in documents(world):
        assert document["inputs"]["mounting"]["R_va"] in (None, np.eye(3).tolist())
    assert documents(world)[-1]["inputs"]["mounting"]["status"] == "ready"


def test_a_box_that_the_impact_turned_keeps_the_mounting_before_it(world):
    """The move is seen as beginning 2 s before the event that caused it."""
    world.reconstructor.events = []
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(200, 10.0, down=-1.0)), seconds=50.0)):
        world.put(batch, k)
    world.settle()
    (_, moved) = world.rows(Installation, Installation.began_at)
    assert moved.beginning == "moved"
    at = moved.began_at.timestamp() - 1_772_366_400.0 + 2.0
    world.reconstructor.events = [crash(at)]
    world.put(burst(around=at), 0, stream="burst")
    world.bring_up()
    assert world.one(Event).kind == "crash"
    assert documents(world)[-1]["inputs"]["mounting"]["R_va"] == np.eye(3).tolist()


def test_a_mounting_that_becomes_ready_revises_what_waited_for_it(world):
    world.put(burst(around=20.0), 0, stream="burst")
    world.reconstructor.events = [crash(20.0, status="insufficient")]
    world.bring_up()
    assert documents(world)[-1]["inputs"]["mounting"]["status"] == "insufficient"
    world.reconstructor.events = [crash(20.0)]
    for k, batch in enumerate(cut(drive_of(Leg(200, 12.0)), seconds=100.0)):
        world.put(batch, k)
        world.bring_up()
    world.settle()
    assert documents(world)[-1]["inputs"]["mounting"]["status"] == "ready"


def test_a_manoeuvre_is_not_revised_without_news_and_withdrawn_when_it_was_none(world):
    world.reconstructor.events = [braking(55.0)]
    batches = cut(drive_of(Leg(200, 12.0)), seconds=20.0)
    for k in (0, 1, 2):
        world.put(batches[k], k)
        world.bring_up()
    assert world.one(Event).revision == 1
    world.reconstructor.events = []
    world.put(batches[2], 7, stream="burst")
    world.bring_up()
    assert world.one(Event).withdrawn_at is not None
    with world.database.reading() as session:
        assert not queries.events(session, world.organisation.id, limit=5)


@pytest.mark.parametrize(("seconds", "found_at"), [(20.0, 0.0), (20.0, 250.0), (300.0, 0.0)])
def test_manoeuvres_are_judged_with_the_mounting_of_their_time_however_late_a_move_is_found(world, seconds, found_at):
    """One that only the old mounting shows, after the move; one that only the new one shows; one before the move."""
    upright, over = np.eye(3).tolist(), np.diag([1.0, -1.0, -1.0]).tolist()
    shown = {60.0: upright, 130.0: upright, 145.0: over, 200.0: over}

    def seen(drive, mounting, **options):
        found = Reconstructor(*(braking(at) for at in shown))(drive, mounting, **options)
        R_va = None if mounting.R_va is None else mounting.R_va.tolist()
        return tuple(each for each in found if shown[each.t0] == R_va)

    estimator = world.estimator

    def late(ticks, gnss, *others):
        early = ticks.t[-1] < found_at
        told = estimator(ticks, gnss, *others)
        return told._replace(estimate=replace(told.estimate, R_va=np.eye(3), changes=())) if early else told

    world.estimator, world.reconstructor = late, seen
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(200, 10.0, down=-1.0)), seconds=seconds)):
        world.put(batch, k)
        world.bring_up()
    world.settle()
    assert [row.beginning for row in world.rows(Installation, Installation.began_at)] == ["first", "moved"]
    stand = [row.t0_s for row in world.rows(Event, Event.t0_s) if row.withdrawn_at is None]
    assert stand == [60.0, 145.0, 200.0]


def test_a_severe_event_is_found_again_when_a_stronger_blow_of_it_comes_to_light(world):
    """The burst holds the first blow; what comes later holds a stronger one 3 s on: one event, its headline moves."""
    world.put(burst(), 0, stream="burst")
    world.bring_up()
    first = world.one(Event)
    weaker = crash(T0).second_impacts[0]
    weaker = replace(weaker, t0=T0, t_end=T0 + 0.1)
    world.reconstructor.events = [replace(crash(T0 + 3.0), second_impacts=(weaker,))]
    for k, batch in enumerate(cut(drive_of(*DRIVE), seconds=20.0)):
        world.put(batch, k)
        world.bring_up()
    event = world.one(Event)
    assert (event.id, event.withdrawn_at) == (first.id, None)
    assert event.t0_s == T0 + 3.0


def test_events_that_cannot_be_computed_keep_no_batch_from_being_worked_off(world):
    def broken(*_, **__):
        raise ValueError("bad")

    world.reconstructor = broken
    world.put(cut(drive_of(*DRIVE))[0], 0)
    assert world.bring_up().batches == 1
    assert world.unprocessed() == 0


def test_a_burst_goes_before_a_backlog(world):
    for k, batch in enumerate(cut(drive_of(*DRIVE))):
        world.put(batch, k)
    world.put(burst(), 0, stream="burst")
    with world.database.reading() as session:
        assert burst_devices(session, 5) == [world.device_id]
    outcome = world.bring_up()
    assert (outcome.batches, outcome.more) == (1, True)
    assert world.one(Event).kind == "crash"
    with world.database.reading() as session:
        assert burst_devices(session, 5) == []


@both
def test_the_database_does_not_lose_what_an_event_rests_on(world):
    world.put(burst(), 0, stream="burst")
    world.bring_up()
    with pytest.raises(IntegrityError), world.database.transaction() as session:
        session.execute(delete(Batch))


def test_of_overlapping_streams_the_higher_rate_wins_and_fixes_stay():
    slow, quick = from_drive(drive_of(Leg(20, 5.0))), burst(around=10.0)
    joined = merged([Part(slow, False), Part(quick, True)])
    t, fx = joined.values["t"], joined.values["fx"]
    inside = (t > 8.0) & (t < 11.99) & ~np.isnan(fx)
    assert np.median(np.diff(t[inside])) == pytest.approx(1 / 200.0)
    outside = (t < 8.0) & ~np.isnan(fx)
    assert np.median(np.diff(t[outside])) == pytest.approx(1 / 20.0)
    assert np.count_nonzero(~np.isnan(joined.values["speed"])) == 40
    assert np.all(np.diff(t) >= 0.0)


def test_canonical_bytes_do_not_depend_on_order_or_last_bits():
    a = {"b": 0.1 + 0.2, "a": [1, True, None, "é", float("nan")], "c": -0.0}
    b = {"c": 0.0, "a": (1, True, None, "é", float("inf")), "b": 0.3}
    assert canonical(a) == canonical(b) == '{"a":[1,true,null,"é",null],"b":0.3,"c":0.0}'.encode()


def test_a_severe_event_of_another_kind_is_a_revision(world):
    world.put(burst(), 0, stream="burst")
    world.bring_up()
    world.reconstructor.events = [replace(crash(T0), kind="parked_impact")]
    world.put(cut(drive_of(*DRIVE), seconds=20.0)[4], 4)
    world.bring_up()
    event = world.one(Event)
    assert (event.kind, event.revision) == ("parked_impact", 2)


@both
def test_what_an_event_search_read_before_it_was_due_is_worked_off_all_the_same(world):
    """A batch comes while a round computes, is read as an event's surroundings, and the round has to start over."""
    batches = cut(drive_of(*DRIVE), seconds=20.0)
    for k, batch in enumerate(batches[:5]):
        world.put(batch, k)
    world.bring_up()
    world.put(batches[5], 5)
    find, meanwhile = world.reconstructor, []

    def found_while_others_write(*arguments: object, **options: object) -> object:
        if not meanwhile:
            meanwhile.append(world.put(batches[6], 6))
            with world.database.transaction() as session:
                state = session.scalars(select(DeviceState).where(DeviceState.device_id == world.device_id)).one()
                state.version += 1
        return find(*arguments, **options)

    world.reconstructor = found_while_others_write
    assert world.bring_up().batches == 2
    assert meanwhile
    assert world.unprocessed() == 0
    assert {row.batch_id for row in world.rows(BatchDigest)} == {row.id for row in world.rows(Batch)}


@both
def test_what_was_passed_over_before_is_due_after_the_migration(world, settings):
    batches = cut(drive_of(*DRIVE), seconds=20.0)
    for k, batch in enumerate(batches[:3]):
        world.put(batch, k)
    world.bring_up()
    passed_over = world.rows(Batch, Batch.sequence)[1].id
    with world.database.transaction() as session:
        session.execute(delete(BatchDigest).where(BatchDigest.batch_id == passed_over))
    migrations.downgrade(settings, "0011")
    migrations.upgrade(settings)
    assert world.unprocessed() == 1
    world.bring_up()
    assert {row.batch_id for row in world.rows(BatchDigest)} == {row.id for row in world.rows(Batch)}
    (remark,) = next(row.remarks for row in world.rows(Batch) if row.id == passed_over)
    assert remark["code"] == "passed_over"
