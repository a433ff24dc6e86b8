"""Erasure and export of a vehicle's and a person's data, over HTTP and at the command line."""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import json
import zipfile

import pyarrow.parquet as pq
import pytest
import sqlalchemy as sa
from privacy_world import T0, Fleet

from server.cli.main import main
from server.events.canonical import sha256
from server.evidence.audit import audit
from server.evidence.verify import check
from server.formats.columns import Columns
from server.models import (
    AccidentClaim,
    Alert,
    AlertDelivery,
    AuditEntry,
    Batch,
    BatchDigest,
    Boot,
    Change,
    DeviceState,
    Diagnosis,
    Erasure,
    Event,
    EventRevision,
    Installation,
    MountingRevision,
    TrackPoint,
    Trip,
    User,
    Vehicle,
    WebSession,
)
from server.privacy.erasure import run_open

both = pytest.mark.both_databases


@pytest.fixture
def fleet(database, settings, clock, organisation) -> Fleet:
    fleet = Fleet(database, settings, clock, organisation)
    fleet.drive()
    fleet.pass_time(days=3)
    return fleet


@pytest.fixture
def vehicle_url(fleet) -> str:
    return f"/api/v1/vehicles/{fleet.vehicle_id}"


def run(fleet) -> int:
    return run_open(fleet.database, fleet.store, clock=fleet.clock)


def crash_of(fleet) -> Event:
    (row,) = [event for event in fleet.rows(Event) if event.kind == "crash"]
    return row


def tell(fleet, *, at: dt.datetime) -> None:
    """An alert with its message, a claim and named values of the fleet's vehicle."""
    org, key = fleet.organisation.id, f"{at:%Y%m%d%H%M%S}"
    with fleet.database.transaction() as session:
        session.add(
            Alert(
                id=f"a{key}", organisation_id=org, kind="geofence", severity="info", occurrence=key,
                device_id=fleet.device_id, vehicle_id=fleet.vehicle_id, at=at, created_at=at, facts={"lat_deg": 45.1},
            )
        )  # fmt: skip
        session.flush()
        session.add(
            AlertDelivery(
                id=f"d{key}", organisation_id=org, alert_id=f"a{key}", channel_id="c", reason="raised", priority=1,
                state="delivered", created_at=at, due_at=at, body=b"at 45.1",
            )
        )  # fmt: skip
        session.add(
            AccidentClaim(
                id=f"c{key}", organisation_id=org, vehicle_id=fleet.vehicle_id, reference="17", began_at=at,
                ended_at=at, created_at=at, created_by="ada", answer={},
            )
        )  # fmt: skip
        session.add_all(
            Diagnosis(device_id=fleet.device_id, name=name, at=at, value=12.6) for name in ("battery", "temp")
        )


@both
def test_alerts_claims_and_diagnosis_of_the_time_go_and_are_in_the_export(fleet, admin, vehicle_url):
    early = fleet.clock() - dt.timedelta(days=3)
    late = early + dt.timedelta(days=2)
    tell(fleet, at=early)
    tell(fleet, at=late)
    archive = zipfile.ZipFile(io.BytesIO(admin.get(f"{vehicle_url}/export").content))
    for name, count in (("alerts", 2), ("alert_deliveries", 2), ("claims", 2), ("diagnosis", 4)):
        assert len(archive.read(f"{name}.jsonl").splitlines()) >= count, name
    until = (early + dt.timedelta(days=1)).isoformat()
    admin.post(f"{vehicle_url}/erasure", json={"reason": "who drove that day", "until": until})
    assert run(fleet) == 1
    left = [row.created_at for model in (Alert, AlertDelivery) for row in fleet.rows(model)]
    assert left == [late, late]
    assert [row.began_at for row in fleet.rows(AccidentClaim)] == [late]
    assert {row.at for row in fleet.rows(Diagnosis)} == {late}
    told = fleet.one(Erasure).erased
    assert told["alerts"] >= 1
    assert told["claims"] == 1
    assert told["diagnosis"] >= 2


@both
def test_a_vehicle_is_erased_and_its_certificate_agrees_with_the_chain(fleet, admin, vehicle_url):
    plan = admin.post(f"{vehicle_url}/erasure", json={"reason": "asked", "dry_run": True}).json()
    batches = len(fleet.rows(Batch))
    takes = plan["would_erase"]
    assert takes["batches"] == batches
    assert takes["events"] == 2
    assert takes["track_points"] == len(fleet.rows(TrackPoint)) > 100
    assert fleet.rows(Erasure) == []
    order = admin.post(f"{vehicle_url}/erasure", json={"reason": "letter of 1 March"})
    assert order.status_code == 202
    url = f"/api/v1/erasures/{order.json()['id']}"
    early = admin.get(f"{url}/certificate")
    assert (early.status_code, early.json()["code"]) == (409, "not_finished")
    crash_id = crash_of(fleet).id
    assert run(fleet) == 1
    assert run(fleet) == 0
    told = admin.get(url).json()
    assert told["finished_at"] is not None
    assert {name: told["erased"][name] for name in takes} == takes
    assert [kept["what"] for kept in told["kept"]] == ["audit entries"]
    for model in (TrackPoint, Trip, BatchDigest, Installation, MountingRevision):
        assert fleet.rows(model) == [], model
    assert all(change.vehicle_id is None for change in fleet.rows(Change))
    assert "lat_deg" not in str([change.data for change in fleet.rows(Change)])
    assert fleet.one(DeviceState).lat_deg is None
    assert all(boot.trip_state == {} for boot in fleet.rows(Boot))
    vehicle = fleet.one(Vehicle)
    assert (vehicle.plate, vehicle.name) == (None, f"Erased vehicle {vehicle.id[:8]}")
    for row in fleet.rows(Batch):
        assert row.erased_at is not None
        assert not fleet.store.exists(row.blob_key)
    found = audit(fleet.database, fleet.store, fleet.device_id)
    assert found.passed, found.faults
    assert found.erased_links == batches
    certificate = admin.get(f"{url}/certificate").json()
    assert certificate["sha256"] == sha256({k: v for k, v in certificate.items() if k != "sha256"})
    assert [b["column_sha256"] for b in certificate["batches"]] == [
        row.column_sha256 for row in fleet.rows(Batch, Batch.chain_index)
    ]
    assert certificate["reason"] == "letter of 1 March"
    assert len(certificate["event_revisions"]) == len(fleet.rows(EventRevision))
    # Gone for everybody.
    gone = admin.get(f"/api/v1/events/{crash_id}")
    assert (gone.status_code, gone.json()["code"]) == (410, "erased")
    assert admin.get(f"/events/{crash_id}").status_code == 410
    assert admin.get("/api/v1/events").json()["items"] == []
    assert admin.get("/").status_code == admin.get(f"/vehicles/{fleet.vehicle_id}").status_code == 200
    actions = [entry.action for entry in fleet.rows(AuditEntry, AuditEntry.id)]
    assert [a for a in actions if a.startswith("erasure")] == ["erasure.ordered", "erasure.finished"]
    # The box goes on as before.
    fleet.clock.advance(hours=1)
    fleet.drive_on()
    assert len(fleet.rows(Batch)) == batches + 3
    assert fleet.unprocessed() == 0
    assert fleet.rows(Trip)


@both
def test_a_hold_makes_an_erasure_partial(fleet, admin, vehicle_url):
    event = crash_of(fleet)
    tell(fleet, at=event.at)
    tell(fleet, at=event.at + dt.timedelta(hours=1))
    with fleet.database.transaction() as session:
        session.execute(sa.update(Alert).where(Alert.at == event.at).values(event_id=event.id))
    admin.put(f"/api/v1/events/{event.id}/hold", json={"held": True, "reason": "claim 17"}).raise_for_status()
    plan = admin.post(f"{vehicle_url}/erasure", json={"reason": "asked", "dry_run": True}).json()
    kept = {row["what"]: row["count"] for row in plan["would_keep"]}
    assert kept["event"] == 1
    assert kept["batches"] > 3
    admin.post(f"{vehicle_url}/erasure", json={"reason": "asked"}).raise_for_status()
    run(fleet)
    shown = admin.get("/api/v1/erasures").json()[0]
    about_it = {"event", "batches", "trips", "alerts", "claims"}
    assert {row["what"] for row in shown["kept"]} == {*about_it, "name and plate", "audit entries"}
    # Of alerts and claims, those of that event and no others.
    assert {row.event_id for row in fleet.rows(Alert)} == {event.id}
    assert [row.began_at for row in fleet.rows(AccidentClaim)] == [event.at]
    assert kept["claims"] == 1
    assert fleet.one(Vehicle).plate == "AB123CD"
    rows = fleet.rows(Batch)
    assert len([row for row in rows if row.erasing_at is None]) == kept["batches"]
    evidence = admin.get(f"/api/v1/events/{event.id}/evidence.zip")
    with zipfile.ZipFile(io.BytesIO(evidence.content)) as bundle:
        report = check(bundle.read, bundle.namelist())
    assert report.passed, report.lines
    assert admin.get("/api/v1/holds").json()[0]["event_id"] == event.id
    log = [(e.action, e.detail) for e in fleet.rows(AuditEntry, AuditEntry.id) if e.action.startswith("hold")]
    assert log == [("hold.placed", {"reason": "claim 17"})]
    # Once it is over, a further order takes the rest.
    admin.put(f"/api/v1/events/{event.id}/hold", json={"held": False, "reason": "settled"}).raise_for_status()
    admin.post(f"{vehicle_url}/erasure", json={"reason": "again"}).raise_for_status()
    run(fleet)
    assert all(row.erased_at is not None for row in fleet.rows(Batch))
    assert fleet.rows(Alert) == fleet.rows(AccidentClaim) == []
    assert audit(fleet.database, fleet.store, fleet.device_id).passed


@both
def test_of_a_time_only_whoever_drove_then_is_erased(fleet, admin, vehicle_url):
    began = dt.datetime.fromtimestamp(1_772_366_400, dt.UTC)
    period = {"since": (began + dt.timedelta(seconds=450)).isoformat()}
    admin.post(f"{vehicle_url}/erasure", json={"reason": "asked", **period}).raise_for_status()
    run(fleet)
    rows = fleet.rows(Batch)
    assert all((row.erasing_at is not None) == (0.5 * (row.t_first_s + row.t_last_s) >= 450.0) for row in rows)
    kinds = {event.kind: event.erased_at for event in fleet.rows(Event)}
    assert kinds["crash"] is None
    assert kinds["harsh_braking"] is not None
    assert fleet.one(Vehicle).plate == "AB123CD"
    assert all(trip.t_first_s < 450.0 for trip in fleet.rows(Trip))
    assert fleet.rows(Installation)
    wrong = {"reason": "x", "since": "2026-03-02T00:00:00Z", "until": "2026-03-01T00:00:00Z"}
    assert admin.post(f"{vehicle_url}/erasure", json=wrong).status_code == 422
    extreme = {"reason": "x", "since": "0001-01-01T00:00:00+23:00"}
    assert admin.post(f"{vehicle_url}/erasure", json=extreme).status_code == 422


def test_evidence_whose_raw_data_were_erased_says_so(fleet, admin):
    event = crash_of(fleet)
    with fleet.database.transaction() as session:
        session.execute(sa.update(Batch).where(Batch.t_first_s < T0).values(erasing_at=fleet.clock()))
    evidence = admin.get(f"/api/v1/events/{event.id}/evidence.zip")
    with zipfile.ZipFile(io.BytesIO(evidence.content)) as bundle:
        report = check(bundle.read, bundle.namelist())
    assert report.passed, report.lines
    assert any(limit.startswith("ERASED: raw/") for limit in report.limits)


@both
def test_a_vehicles_export_holds_everything(fleet, admin, vehicle_url):
    answer = admin.get(f"{vehicle_url}/export")
    assert answer.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as bundle:
        assert bundle.testzip() is None
        names = set(bundle.namelist())
        lines = {
            name: [json.loads(line) for line in bundle.read(name).splitlines()]
            for name in names
            if name.endswith(".jsonl")
        }
        batches = fleet.rows(Batch, Batch.chain_index)
        for batch in batches:
            columns = Columns.from_parquet(bundle.read(f"raw/{fleet.device_id}/{batch.chain_index}.parquet"))
            assert columns.column_sha256() == batch.column_sha256
        for revision in fleet.rows(EventRevision):
            content = bundle.read(f"events/{revision.event_id}/{revision.number}.json")
            assert hashlib.sha256(content).hexdigest() == revision.event_sha256
        points = sum(pq.read_table(io.BytesIO(bundle.read(n))).num_rows for n in names if n.startswith("tracks/"))
    assert points == len(fleet.rows(TrackPoint))
    assert lines["vehicle.jsonl"][0]["plate"] == "AB123CD"
    assert len(lines["batches.jsonl"]) == len(batches)
    assert len(lines["events.jsonl"]) == 2
    assert len(lines["trips.jsonl"]) == len(fleet.rows(Trip))
    assert "token_hash" not in lines["devices.jsonl"][0]
    (entry,) = [e for e in fleet.rows(AuditEntry) if e.action == "privacy.export"]
    assert entry.subject == f"vehicle {fleet.vehicle_id}"
    later = (fleet.clock() + dt.timedelta(days=1)).isoformat()
    nothing = admin.get(f"{vehicle_url}/export", params={"from": later})
    with zipfile.ZipFile(io.BytesIO(nothing.content)) as bundle:
        assert bundle.read("batches.jsonl") == b""
    # Its own permission, and those for places and samples.
    scopes = ["fleet.read", "location.read", "raw.read"]
    key = admin.post("/api/v1/api-keys", json={"name": "k", "scopes": scopes}).json()["key"]
    refused = admin.get(f"{vehicle_url}/export", headers={"Authorization": f"Bearer {key}"})
    assert refused.status_code == 403


@both
def test_a_person_is_exported_and_erased(admin, client, database, clock):
    ada = admin.post("/api/v1/users", json={"email": "ada@fleet.test", "name": "Ada", "role": "manager"}).json()
    client.post("/api/v1/auth/session", json={"code": ada["code"]}).raise_for_status()
    url = f"/api/v1/users/{ada['id']}"
    with zipfile.ZipFile(io.BytesIO(admin.get(f"{url}/export").content)) as bundle:
        text = b"".join(bundle.read(name) for name in bundle.namelist()).decode()
    assert "ada@fleet.test" in text
    assert "user.added" in text
    assert "token_hash" not in text
    assert "totp_secret" not in text
    plan = admin.post(f"{url}/erasure", json={"reason": "left", "dry_run": True}).json()
    assert plan["would_erase"]["sessions"] == 1
    order = admin.post(f"{url}/erasure", json={"reason": "left"}).json()
    run_open(database, None, clock=clock)
    told = admin.get(f"/api/v1/erasures/{order['id']}").json()
    assert told["erased"]["account"] == 1
    assert [kept["what"] for kept in told["kept"]] == ["audit entries"]
    assert admin.get(f"/api/v1/erasures/{order['id']}/certificate").json()["subject"]["id"] == ada["id"]
    with database.reading() as session:
        user = session.get_one(User, ada["id"])
        assert (user.email, user.name) == (f"erased-{user.id}@erased.invalid", "Erased user")
        assert session.scalars(sa.select(WebSession)).all() == []
    assert client.get("/api/v1/account").status_code == 401
    assert admin.get("/users").status_code == 200


def test_the_last_administrator_stays(admin, database, clock):
    root = admin.post("/api/v1/users", json={"email": "r@fleet.test", "name": "R", "role": "admin"}).json()
    order = admin.post(f"/api/v1/users/{root['id']}/erasure", json={"reason": "left"}).json()
    run_open(database, None, clock=clock)
    (kept,) = admin.get(f"/api/v1/erasures/{order['id']}").json()["kept"]
    assert kept["what"] == "account"
    assert admin.get("/api/v1/users").json()[0]["email"] == "r@fleet.test"


@both
def test_rules_over_http(admin, database):
    shown = {row["data_class"]: row for row in admin.get("/api/v1/retention").json()}
    assert shown["raw"]["days"] == 90
    assert shown["raw"]["updated_by"] == "default"
    answer = admin.put("/api/v1/retention", json={"days": {"raw": 30, "events": None}})
    changed = {row["data_class"]: row for row in answer.json()}
    assert (changed["raw"]["days"], changed["events"]["days"], changed["tracks"]["days"]) == (30, None, 365)
    assert changed["raw"]["applies_at"] == changed["raw"]["updated_at"]
    for wrong in ({"raw": 0}, {"raw": 10**9}, {"cookies": 3}, {"raw": "x"}):
        assert admin.put("/api/v1/retention", json={"days": wrong}).status_code == 422
    with database.reading() as session:
        entry = session.scalars(sa.select(AuditEntry).where(AuditEntry.action == "retention.set")).one()
    assert entry.detail == {"days": {"raw": [90, 30], "events": [3650, None]}}


def test_the_page(admin, fleet):
    page = admin.get("/privacy")
    assert page.status_code == 200
    assert "AB123CD" in page.text
    assert admin.post("/privacy/retention", data={"raw": "12", "events": ""}).headers["location"].endswith("rules")
    rules = {row["data_class"]: row["days"] for row in admin.get("/api/v1/retention").json()}
    assert (rules["raw"], rules["events"], rules["tracks"]) == (12, None, 365)
    wrong = admin.post("/privacy/retention", data={"raw": "soon"})
    assert (wrong.status_code, "days from 1" in wrong.text) == (422, True)
    form = {"subject": f"vehicle:{fleet.vehicle_id}", "reason": "asked"}
    plan = admin.post("/privacy/erasure", data=form)
    assert "What would be erased: Van" in plan.text
    assert fleet.rows(Erasure) == []
    swapped = {"since": "2026-03-02", "until": "2026-02-01"}
    for broken in ({"since": "soon"}, {"subject": "x:y"}, {"reason": " "}, swapped, {"until": "9999-12-31"}):
        assert admin.post("/privacy/erasure", data={**form, **broken}).status_code == 422, broken
    assert admin.post("/privacy/erasure", data={**form, "act": "erase"}).status_code == 303
    assert "under way" in admin.get("/privacy").text


def test_at_the_command_line(fleet, settings, monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    assert main(["erase", "vehicle", fleet.vehicle_id, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["would_erase"]["events"] == 2
    assert main(["erase", "vehicle", "0" * 32, "--dry-run"]) == 1
    assert "there is no vehicle" in capsys.readouterr().err
    assert main(["erase", "vehicle", fleet.vehicle_id]) == 1
    assert main(["erase", "vehicle", fleet.vehicle_id, "--reason", "asked", "--from", "soon"]) == 1
    capsys.readouterr()
    # The blobs of this test are younger than a day by the wall: they wait for the worker.
    assert main(["erase", "vehicle", fleet.vehicle_id, "--reason", "asked", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["finished_at"] is None
    assert told["erased"]["batches"] == len(fleet.rows(Batch))
    assert run(fleet) == 1
    assert main(["verify", "--json"]) == 0
    box = next(b for b in json.loads(capsys.readouterr().out)["devices"] if b["device_id"] == fleet.device_id)
    assert box["erased_links"] == box["links"] == len(fleet.rows(Batch))
