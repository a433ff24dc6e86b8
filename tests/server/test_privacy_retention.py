"""What is older than its rule goes, the hashes stay, a hold beats all of it, and a run may die anywhere."""

from __future__ import annotations

import datetime as dt

import pytest
import sqlalchemy as sa
from fleet_world import Leg, cut, drive_of
from privacy_world import Fleet

from server.events import service as events
from server.evidence.audit import audit
from server.jobs.work import bring_up_to_date
from server.models import (
    Alert,
    Analysis,
    AuditEntry,
    Batch,
    BatchDigest,
    Change,
    Diagnosis,
    Event,
    EventInput,
    EventRevision,
    RetentionRule,
    TrackPoint,
    Trip,
)
from server.privacy import policy, retention, tombstones
from server.privacy.retention import apply_retention
from server.store import collect, raw_columns

pytestmark = pytest.mark.both_databases


@pytest.fixture
def fleet(database, settings, clock, organisation) -> Fleet:
    fleet = Fleet(database, settings, clock, organisation)
    fleet.drive()
    return fleet


def set_days(fleet, **days) -> None:
    with fleet.database.transaction() as session:
        keep: dict[str, int | None] = dict.fromkeys(policy.DEFAULT_DAYS)
        policy.set_rules(session, fleet.organisation.id, {**keep, **days}, actor="test", now=fleet.clock())


def hold(fleet, event_id, *, held=True) -> None:
    with fleet.database.transaction() as session:
        events.hold(
            session, fleet.organisation.id, event_id, held=held, reason="claim 17", actor="ada", now=fleet.clock()
        )


def verify(fleet):
    return audit(fleet.database, fleet.store, fleet.device_id)


def of_kind(fleet, kind) -> Event:
    (row,) = [event for event in fleet.rows(Event) if event.kind == kind]
    return row


def inputs(fleet, event) -> set[str]:
    return {row.batch_id for row in fleet.rows(EventInput) if row.event_id == event.id}


def test_raw_data_go_but_for_those_a_crash_rests_on_and_the_chain_still_verifies(fleet):
    set_days(fleet, raw=30)
    crash_inputs = inputs(fleet, of_kind(fleet, "crash"))
    assert 0 < len(crash_inputs) < len(fleet.rows(Batch))
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {}
    fleet.pass_time(days=31)
    removed = apply_retention(fleet.database, fleet.store, now=fleet.clock())
    rows = fleet.rows(Batch, Batch.chain_index)
    erased = [row for row in rows if row.erased_at is not None]
    assert {row.id for row in rows if row.erasing_at is None} == crash_inputs
    assert removed.counts == {"raw": len(erased)}
    assert removed.blobs_gone == len(erased)
    for row in rows:
        assert fleet.store.exists(row.blob_key) == (row.erased_at is None)
    with pytest.raises(KeyError):
        raw_columns(fleet.store, erased[0])
    assert len(fleet.rows(BatchDigest)) == len(crash_inputs)
    found = verify(fleet)
    assert found.passed, found.faults
    assert (found.links, found.erased_links) == (len(rows), len(erased))
    # What rested on them says so; the crash does not, for its own are there.
    assert of_kind(fleet, "harsh_braking").raw_erased_at is not None
    assert of_kind(fleet, "crash").raw_erased_at is None
    assert all(trip.raw_erased_at is not None for trip in fleet.rows(Trip))
    (told,) = [entry for entry in fleet.rows(AuditEntry) if entry.action == "retention"]
    assert (told.subject, told.detail["removed"], told.actor_kind) == ("raw", len(erased), "job")
    # A second run has nothing to do, and tells nothing.
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {}
    assert len([entry for entry in fleet.rows(AuditEntry) if entry.action == "retention"]) == 1


def test_a_tombstone_that_was_altered_is_found(fleet):
    set_days(fleet, raw=30)
    fleet.pass_time(days=31)
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    with fleet.database.transaction() as session:
        erased = session.scalars(sa.select(Batch).where(Batch.erased_at.is_not(None)).limit(1)).one()
        erased.column_sha256 = "0" * 64
    assert not verify(fleet).passed


def test_crashes_become_tombstones_and_then_their_raw_data_go_too(fleet):
    set_days(fleet, raw=30, events=100)
    fleet.pass_time(days=101)
    first = apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert first.counts["events"] == 1
    event = of_kind(fleet, "crash")
    assert event.erased_at is not None
    assert event.result == {}
    assert all(row.document == b"" for row in fleet.rows(EventRevision) if row.event_id == event.id)
    assert of_kind(fleet, "harsh_braking").erased_at is None
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert all(row.erased_at is not None for row in fleet.rows(Batch))
    found = verify(fleet)
    assert found.passed, found.faults
    assert found.erased_revisions > 0


def test_a_hold_beats_every_rule_until_it_ends(fleet):
    event = of_kind(fleet, "crash")
    braked = of_kind(fleet, "harsh_braking")
    hold(fleet, event.id)
    hold(fleet, braked.id)
    # A batch that reaches into the window and comes later is kept as well.
    late = fleet.put(cut(drive_of(Leg(20, 0.0), start=40.0))[0], 900)
    fleet.settle()
    set_days(fleet, raw=1, tracks=1, trips=1, manoeuvres=1, events=1)
    fleet.pass_time(days=400)
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    kept = {row.id for row in fleet.rows(Batch) if row.erasing_at is None}
    assert kept >= inputs(fleet, event) | inputs(fleet, braked) | {late}
    assert of_kind(fleet, "crash").result["kind"] == "crash"
    assert all(trip.track_erased_at is None for trip in fleet.rows(Trip) if trip.t_first_s <= event.t0_s)
    assert fleet.rows(TrackPoint)
    hold(fleet, event.id, held=False)
    hold(fleet, braked.id, held=False)
    for _ in range(2):
        apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert all(row.erased_at is not None for row in fleet.rows(Batch))
    assert fleet.rows(Trip) == []
    assert verify(fleet).passed


def test_tracks_go_before_trips(fleet):
    set_days(fleet, tracks=10, trips=20)
    fleet.pass_time(days=11)
    fleet.clock.now = dt.datetime.fromtimestamp(1_772_366_400, dt.UTC) + dt.timedelta(days=11)
    trips = len(fleet.rows(Trip))
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {"tracks": trips}
    assert fleet.rows(TrackPoint) == []
    assert all(trip.track_erased_at == fleet.clock() for trip in fleet.rows(Trip))
    fleet.clock.advance(days=10)
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {"trips": trips}


def test_changes_and_audit_entries_go_but_never_the_newest_change(fleet):
    old = fleet.clock() - dt.timedelta(days=50)
    with fleet.database.transaction() as session:
        for k in range(3):
            session.add(
                AuditEntry(
                    at=old,
                    organisation_id=fleet.organisation.id,
                    actor_kind="job",
                    actor_name="x",
                    action="a",
                    subject=str(k),
                    address="",
                )
            )
    set_days(fleet, audit=30, changes=1)
    highest = max(row.id for row in fleet.rows(Change))
    removed = apply_retention(fleet.database, fleet.store, now=fleet.clock() + dt.timedelta(days=3))
    assert removed.counts["audit"] == 3
    assert [row.id for row in fleet.rows(Change)] == [highest]
    assert [row.action for row in fleet.rows(AuditEntry)] == ["retention", "retention"]
    with pytest.raises(sa.exc.DBAPIError, match="only grows"), fleet.database.transaction() as session:
        session.execute(sa.text("UPDATE audit_entry SET subject = 'x'"))


def test_defaults_wait_a_week_before_they_remove_anything(fleet):
    fleet.pass_time(days=4000)
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {}
    assert {row.data_class: row.days for row in fleet.rows(RetentionRule)} == policy.DEFAULT_DAYS
    fleet.pass_time(days=8)
    fleet.clock.advance(days=4000)
    assert "raw" in apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts


class Dying:
    """A store whose process dies at the n-th deletion."""

    def __init__(self, store, after) -> None:
        self._store, self._after = store, after

    def __getattr__(self, name):
        return getattr(self._store, name)

    def delete_stale(self, key, before):
        self._after -= 1
        if self._after < 0:
            raise SystemExit(1)
        return self._store.delete_stale(key, before)


def test_a_run_that_dies_leaves_nothing_half_erased(fleet, monkeypatch):
    monkeypatch.setattr(tombstones, "CHUNK", 7)
    set_days(fleet, raw=30)
    fleet.pass_time(days=31)
    for after in (3, 9):
        with pytest.raises(SystemExit):
            apply_retention(fleet.database, Dying(fleet.store, after), now=fleet.clock())
        rows = fleet.rows(Batch)
        # A row says `erased` only where the blob is gone; the others are not read any more.
        assert all(not fleet.store.exists(row.blob_key) for row in rows if row.erased_at is not None)
        waiting = [row for row in rows if row.erasing_at is not None and row.erased_at is None]
        assert waiting
        assert verify(fleet).passed
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert all((row.erasing_at is None) == (row.erased_at is None) for row in fleet.rows(Batch))


def test_a_run_that_dies_before_it_tells_the_log_is_told_by_the_next(fleet, monkeypatch):
    monkeypatch.setattr(tombstones, "CHUNK", 5)
    set_days(fleet, raw=30)
    fleet.pass_time(days=31)
    looks = iter([False, False, True])
    first = apply_retention(fleet.database, fleet.store, now=fleet.clock(), stopped=lambda: next(looks))
    assert first.counts == {"raw": 15}
    assert [entry for entry in fleet.rows(AuditEntry) if entry.action == "retention"] == []
    second = apply_retention(fleet.database, fleet.store, now=fleet.clock())
    told = [entry.detail["removed"] for entry in fleet.rows(AuditEntry) if entry.action == "retention"]
    assert sum(told) == first.counts["raw"] + second.counts["raw"]


def test_a_fresh_blob_waits_and_the_collector_takes_what_no_row_holds(fleet):
    set_days(fleet, raw=1)
    now = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
    fleet.clock.now = now
    removed = apply_retention(fleet.database, fleet.store, now=now)
    assert removed.counts["raw"] > 0
    assert removed.blobs_gone == 0
    marked = [row for row in fleet.rows(Batch) if row.erasing_at is not None]
    assert all(fleet.store.exists(row.blob_key) for row in marked)
    assert verify(fleet).erased_links == len(marked)
    later = now + dt.timedelta(days=2)
    assert collect(fleet.store, fleet.database, later - dt.timedelta(days=1)) == len(marked)
    assert tombstones.finish_batches(fleet.database, fleet.store, now=later) == len(marked)


def test_a_blob_that_a_kept_row_shares_stays(fleet):
    event = of_kind(fleet, "crash")
    hold(fleet, event.id)
    # The first that the crash rests on: before the blow, which would be a crash of its own on another run of the clock.
    held = next(row for row in fleet.rows(Batch, Batch.chain_index) if row.id in inputs(fleet, event))
    # The same columns once more, on another run of the clock: another row, the same blob.
    again = fleet.put(raw_columns(fleet.store, held), 0, boot="again")
    fleet.settle()
    set_days(fleet, raw=1)
    fleet.pass_time(days=3)
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    rows = {row.id: row for row in fleet.rows(Batch)}
    assert rows[again].erased_at is not None
    assert rows[held.id].erasing_at is None
    assert fleet.store.exists(held.blob_key)
    assert verify(fleet).passed


def test_a_round_of_work_that_saw_the_data_before_starts_over(fleet):
    fleet.put(cut(drive_of(Leg(20, 9.0), start=800.0))[0], 500)

    def erased_meanwhile(*_, **__):
        if not fleet.erased:
            fleet.erased = True
            with fleet.database.transaction() as session:
                tombstones.mark_batches(session, fleet.device_id, now=fleet.clock())
        return ()

    fleet.erased = False
    fleet.clock.advance(seconds=60.0)
    bring_up_to_date(
        fleet.database,
        fleet.store,
        fleet.device_id,
        clock=fleet.clock,
        estimator=fleet.estimator,
        reconstructor=erased_meanwhile,
    )
    assert fleet.erased
    assert fleet.rows(BatchDigest) == []
    assert fleet.unprocessed() == 0
    assert all(row.erasing_at is not None for row in fleet.rows(Batch))


def test_late_data_do_not_make_worse_what_rests_on_erased_ones(fleet):
    braked = of_kind(fleet, "harsh_braking")
    before = {trip.id: trip.distance_m for trip in fleet.rows(Trip)}
    with fleet.database.transaction() as session:
        tombstones.mark_batches(session, fleet.device_id, now=fleet.clock())
    fleet.put(cut(drive_of(Leg(10, 9.0), start=595.0))[0], 901)
    fleet.settle()
    assert of_kind(fleet, "harsh_braking").revision == braked.revision
    assert {trip.id: trip.distance_m for trip in fleet.rows(Trip)}.items() >= before.items()


def test_rules_apply_to_their_own_organisation_only(fleet):
    from server.models import Organisation

    with fleet.database.transaction() as session:
        session.add(Organisation(id="f" * 32, name="other", created_at=fleet.clock()))
        session.flush()
        policy.set_rules(session, "f" * 32, {"raw": 1, "events": 1}, actor="them", now=fleet.clock())
    set_days(fleet)
    fleet.pass_time(days=4000)
    assert apply_retention(fleet.database, fleet.store, now=fleet.clock()).counts == {}
    assert retention.ROWS > 0


def test_old_alerts_and_values_go_by_their_own_rules(fleet, monkeypatch):
    monkeypatch.setattr(tombstones, "ROWS", 3)  # several pieces
    now = fleet.clock() + dt.timedelta(days=20)
    with fleet.database.transaction() as session:
        for day in range(10):
            at = now - dt.timedelta(days=day, hours=1)
            session.add(
                Alert(
                    id=f"a{day}", organisation_id=fleet.organisation.id, kind="silent", severity="info",
                    occurrence=str(day), device_id=fleet.device_id, at=at, created_at=at, facts={},
                )
            )  # fmt: skip
            session.add_all(Diagnosis(device_id=fleet.device_id, name=n, at=at, value=1.0) for n in ("a", "b"))
    set_days(fleet, alerts=4, diagnosis=2)
    removed = apply_retention(fleet.database, fleet.store, now=now).counts
    assert removed["alerts"] >= 6
    assert removed["diagnosis"] >= 16
    assert sorted(row.id for row in fleet.rows(Alert)) == ["a0", "a1", "a2", "a3"]
    assert len(fleet.rows(Diagnosis)) == 4
    told = {row.subject: row.detail["removed"] for row in fleet.rows(AuditEntry) if row.action == "retention"}
    assert told == {name: removed[name] for name in ("alerts", "diagnosis")}


def test_what_the_workbench_made_goes_with_the_rule_of_raw_data(fleet):
    key = f"{fleet.organisation.id}/workbench/in.input"
    fleet.store.put(key, b"x")
    with fleet.database.transaction() as session:
        session.add(
            Analysis(
                organisation_id=fleet.organisation.id,
                creator="ada",
                kind="allan",
                name="rest",
                parameters={},
                created_at=fleet.clock(),
                input_key=key,
                status="done",
            )
        )
    set_days(fleet, raw=30)
    fleet.clock.advance(days=29)
    apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert fleet.one(Analysis).input_key == key
    fleet.pass_time(days=2)
    removed = apply_retention(fleet.database, fleet.store, now=fleet.clock())
    assert removed.counts["raw"] >= 1
    assert fleet.rows(Analysis) == []
    collect(fleet.store, fleet.database, fleet.clock() - dt.timedelta(days=1))
    assert not fleet.store.exists(key)
