"""Re-runs: shared out, resumed, compared; no event twice, none left out."""

from __future__ import annotations

import datetime as dt
import json
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import sqlalchemy as sa
from crash_world import crash
from fleet_world import World

from server.cli.main import main
from server.events.canonical import settle
from server.events.result import event_json
from server.jobs import rerun
from server.jobs.reprocess import Again, figures
from server.jobs.rerun import ATTEMPTS, LEASE, Reruns, begin, claim, finish, report
from server.models import Device, Event, JobFailure, Rerun, RerunItem
from server.store import open_store

EVENTS = 12
TOLD = settle(event_json(crash(1.0)))


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


@pytest.fixture
def events(world) -> list[str]:
    with world.database.transaction() as session:
        device = session.get_one(Device, world.device_id)
        rows = [
            Event(
                organisation_id=device.organisation_id,
                device_id=device.id,
                boot="b",
                kind="crash",
                severe=True,
                t0_s=float(k),
                t_end_s=k + 0.1,
                at=world.clock() + dt.timedelta(seconds=k),
                created_at=world.clock(),
                updated_at=world.clock(),
                revision=1,
                result=TOLD,
            )
            for k in range(EVENTS)
        ]
        session.add_all(rows)
        session.flush()
        return [row.id for row in rows]


def again(event_id: str, *, faster_kmh: float = 0.0, kind: str = "crash", pdof_deg: float | None = None) -> Again:
    """As `reprocess` tells of an event whose delta-V became so much larger."""
    before = figures(TOLD)
    delta_v = {name: None if v is None else v + faster_kmh for name, v in before["delta_v_kmh"].items()}
    after = {
        **before,
        "delta_v_kmh": delta_v,
        "kind": kind,
        "pdof_deg": before["pdof_deg"] if pdof_deg is None else pdof_deg,
    }
    changed = ("event.delta_v_kmh.resultant",) if faster_kmh else ()
    return Again(event_id, 2, "crash-0", "crash-1", "revised" if changed else "same", changed, before, after)


def start(world) -> str:
    with world.database.transaction() as session:
        return begin(session, world.organisation.id, device_id=None, by="me", now=world.clock()).id


@pytest.mark.both_databases
def test_workers_share_out_a_run_and_each_event_is_done_once(world, events, clock):
    run = start(world)
    lock, computed = threading.Lock(), []

    def compute(_database, _store, event_id, **_):
        with lock:
            computed.append(event_id)
        return again(event_id)

    def work(_):
        reruns = Reruns(world.database, world.store, clock)
        reruns.reprocess = compute
        while reruns.once(wait=False):
            pass

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    assert sorted(computed) == sorted(events)
    with world.database.reading() as session:
        found = report(session, run)
    assert (found.status, found.done, found.total, found.outcomes) == ("done", EVENTS, EVENTS, {"same": EVENTS})
    assert world.one(Rerun).finished_at is not None


@pytest.mark.both_databases
def test_a_worker_that_dies_lets_its_lease_run_out(world, events, clock):
    run = start(world)
    with world.database.transaction() as session:
        taken = claim(session, now=clock())
        assert taken == (run, events[0])
    with world.database.transaction() as session:
        assert claim(session, now=clock()) == (run, events[1])
    clock.advance(seconds=LEASE.total_seconds() + 1.0)
    with world.database.transaction() as session:
        assert claim(session, now=clock()) == taken
        finish(session, *taken, again(taken[1]), now=clock())
    with world.database.transaction() as session:
        # The one that was thought dead comes late and changes nothing.
        finish(session, *taken, again(taken[1], faster_kmh=9.0), now=clock())
        assert session.get_one(RerunItem, taken).outcome == "same"


def test_what_fails_is_tried_again_after_the_others_and_then_given_up(world, events, clock):
    run = start(world)
    tried = []

    def compute(_database, _store, event_id, **_):
        tried.append(event_id)
        if event_id == events[0]:
            raise RuntimeError("token=hunter2")
        return again(event_id)

    reruns = Reruns(world.database, world.store, clock)
    reruns.reprocess = compute
    while True:
        while reruns.once(wait=False):
            pass
        with world.database.reading() as session:
            if report(session, run).status == "done":
                break
        clock.advance(seconds=10.0)
    assert tried.count(events[0]) == ATTEMPTS
    assert tried[:EVENTS] == events
    with world.database.reading() as session:
        item = session.get_one(RerunItem, (run, events[0]))
        assert (item.outcome, item.error) == ("failed", "RuntimeError: token=[redacted]")


def test_another_versions_run_is_left_to_its_workers(world, events, clock):
    run = start(world)
    with world.database.transaction() as session:
        session.get_one(Rerun, run).algorithm = "crash-99"
    with world.database.transaction() as session:
        assert claim(session, now=clock()) is None
    assert events


def test_the_report_compares_before_and_after(world, events, clock):
    run = start(world)
    with world.database.transaction() as session:
        for k, event_id in enumerate(events):
            assert claim(session, now=clock()) == (run, event_id)
            result = again(event_id, faster_kmh=float(k), kind="rollover" if k == 3 else "crash")
            finish(session, run, event_id, result, now=clock())
        session.flush()
        found = report(session, run)
    assert found.outcomes == {"same": 1, "revised": EVENTS - 1}
    assert found.before_algorithms == {"crash-0": EVENTS}
    assert found.kinds_changed == [{"event_id": events[3], "before": "crash", "after": "rollover"}]
    assert found.changed_members == {"event.delta_v_kmh.resultant": EVENTS - 1}
    shift = found.shifts["delta_v_resultant_kmh"]
    assert (shift.events, shift.mean, shift.max_abs) == (EVENTS, pytest.approx(5.5), pytest.approx(11.0))
    assert shift.max_event_id == events[-1]
    assert found.shifts["peak_g"].max_abs == 0.0


def test_directions_meet_at_180_degrees():
    moved = {name: [] for name in rerun._SHIFTS}
    before, after = figures(TOLD) | {"pdof_deg": 179.0}, figures(TOLD) | {"pdof_deg": -179.0}
    rerun._compare(RerunItem(event_id="e", before=before, after=after), [], moved)
    assert moved["pdof_deg"] == [(pytest.approx(2.0), "e")]


@pytest.mark.both_databases
def test_a_run_over_http(admin, world, events, clock):
    begun = admin.post("/api/v1/reruns", json={})
    assert begun.status_code == 201
    run = begun.json()["id"]
    assert (begun.json()["status"], begun.json()["total"]) == ("running", EVENTS)
    reruns = Reruns(world.database, world.store, clock)
    reruns.reprocess = lambda _database, _store, event_id, **_: again(event_id, faster_kmh=1.0)
    for _ in range(5):
        assert reruns.once(wait=False)
    told = admin.get(f"/api/v1/reruns/{run}").json()
    assert (told["status"], told["done"], told["outcomes"]) == ("running", 5, {"revised": 5})
    page = admin.get(f"/api/v1/reruns/{run}/events", params={"limit": 5}).json()
    assert [item["event_id"] for item in page["items"]] == events[:5]
    assert page["items"][0]["after"]["algorithm"] == "crash-1"
    rest = admin.get(f"/api/v1/reruns/{run}/events", params={"after": page["next"], "limit": 100}).json()
    assert (len(rest["items"]), rest["next"], rest["items"][0]["outcome"]) == (EVENTS - 5, None, None)
    assert admin.post(f"/api/v1/reruns/{run}/cancel").json()["status"] == "cancelled"
    assert not reruns.once(wait=False)
    assert [row["id"] for row in admin.get("/api/v1/reruns").json()["items"]] == [run]
    clock.advance(minutes=1)
    later = admin.post("/api/v1/reruns", json={}).json()["id"]
    first = admin.get("/api/v1/reruns", params={"limit": 1}).json()
    second = admin.get("/api/v1/reruns", params={"limit": 1, "before": first["next"]}).json()
    assert [page["items"][0]["id"] for page in (first, second)] == [later, run]
    assert second["next"] is None
    assert admin.post("/api/v1/reruns", json={"device_id": "x"}).status_code == 404
    assert admin.get("/api/v1/reruns/none").status_code == 404


def test_the_command_runs_resumes_and_reports(world, events, settings, monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    monkeypatch.setattr("server.jobs.reprocess.reprocess", lambda _d, _s, event_id, **_: again(event_id))
    run = start(world)  # begun elsewhere and stopped
    assert main(["reprocess", "--report", run, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reports"][0]["done"] == 0
    assert main(["reprocess", "--resume", run, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["reports"][0]["outcomes"] == {"same": EVENTS}
    assert [each["event_id"] for each in told["events"]] == events
    assert main(["reprocess"]) == 0
    assert f"done, {EVENTS} of {EVENTS} events" in capsys.readouterr().out
    assert main(["reprocess", "--resume", "none"]) == 1


def test_processes_share_a_run(world, events, settings, monkeypatch, capsys):
    """In earnest: the events have no data, so each fails in its own way, in two processes."""
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    monkeypatch.setattr(rerun, "ATTEMPTS", 1)
    with world.database.transaction() as session:
        session.execute(sa.delete(Event).where(Event.id.not_in(events[:2])))
    run = start(world)
    assert main(["reprocess", "--resume", run, "--jobs", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["reports"][0]["outcomes"] == {"failed": 2}
    assert open_store(settings) is not None


def test_failing_boxes_a_page_at_a_time(admin, make_device, database, clock):
    boxes = sorted(make_device()[0] for _ in range(5))
    with database.transaction() as session:
        for k, device_id in enumerate(boxes):
            dead_at = clock() if k % 2 else None
            session.add(
                JobFailure(
                    device_id=device_id, failures=3, first_at=clock(), last_at=clock(), dead_at=dead_at, error="x",
                    queue="", job_id="",
                )
            )  # fmt: skip
    found, after = [], ""
    while after is not None:
        page = admin.get("/api/v1/jobs/failures", params={"after": after, "limit": 2}).json()
        assert page["total"] == 5
        found += [each["device_id"] for each in page["items"]]
        after = page["next"]
    assert found == boxes
    dead = admin.get("/api/v1/jobs/failures", params={"dead": True}).json()
    assert ([each["device_id"] for each in dead["items"]], dead["next"]) == (boxes[1::2], None)
