"""Events over HTTP: reading, reviewing, exporting, proving."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import subprocess
import sys
import zipfile

import httpx
import pyarrow.parquet as pq
import pytest
import zstandard
from crash_world import Reconstructor, braking, crash
from fleet_world import Leg, World, cut, drive_of
from mcap.reader import make_reader

from server.cli.main import main
from server.devices.schemas import DeviceIn
from server.devices.service import register
from server.events.queries import canonical_bytes
from server.jobs.reprocess import reprocess, severe_events
from server.models import Batch, Device, Event, EventRevision, Organisation, Vehicle
from server.store import collect

T0 = 100.0
KEYS = [
    "kind",
    "t0_s",
    "t_end_s",
    "delta_v_kmh",
    "delta_v_interval95_kmh",
    "time_of_max_ms",
    "pdof_deg",
    "pdof_interval95_deg",
    "pdof_clock",
    "impact_speed_kmh",
    "impact_speed_interval95_kmh",
    "peak_g",
    "clipped",
    "clipped_samples",
    "asi",
    "olc_g",
    "thiv_kmh",
    "phd_g",
    "injury",
    "quality",
]


@pytest.fixture
def world(admin, database, settings, clock, organisation) -> World:
    """A box that crashed, braked hard before, and has said so."""
    del admin
    world = World(database, settings, clock, organisation)
    world.reconstructor = Reconstructor(crash(T0), braking(50.0))
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(60, 0.0)), seconds=40.0)):
        world.put(batch, k)
        world.bring_up()
    return world


@pytest.fixture
def event(admin, world) -> dict:
    del world
    (found,) = admin.get("/api/v1/events", params={"kind": "crash"}).raise_for_status().json()["items"]
    return found


def test_listing_filters_and_pages(admin, world, event):
    def kinds(**query):
        return [e["kind"] for e in admin.get("/api/v1/events", params=query).raise_for_status().json()["items"]]

    assert kinds() == ["crash", "harsh_braking"]
    assert kinds(device=world.device_id, severe=True) == ["crash"]
    assert kinds(device="0" * 32) == []
    assert kinds(**{"from": event["at"]}) == ["crash"]
    assert kinds(to=event["at"]) == ["harsh_braking"]
    page = admin.get("/api/v1/events", params={"limit": 1}).json()
    assert [e["kind"] for e in page["items"]] == ["crash"]
    assert kinds(before=page["next"]) == ["harsh_braking"]
    for before in ("x", "0001-01-01T00:00:00+10:00~x", "9999-12-31T23:59:59-10:00~x"):
        assert admin.get("/api/v1/events", params={"before": before}).status_code == 422
    for name in ("from", "to"):
        for moment in ("0001-01-01T00:00:00+10:00", "9999-12-31T23:59:59-10:00"):
            assert admin.get("/api/v1/events", params={name: moment}).status_code == 422
    assert admin.get("/api/v1/events", params={"kind": "earthquake"}).status_code == 422
    assert set(KEYS) <= set(event)
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0)
    assert event["pdof_clock"] == 11


def test_one_event_and_its_canonical_json(admin, event):
    detail = admin.get(f"/api/v1/events/{event['id']}").raise_for_status().json()
    content = admin.get(f"/api/v1/events/{event['id']}/event.json").raise_for_status().content
    assert hashlib.sha256(content).hexdigest() == detail["event_sha256"]
    assert detail["algorithm"] == "crash-3"
    assert json.loads(content)["inputs"]["sha256"] == detail["input_sha256"]
    assert admin.get("/api/v1/events/" + "0" * 32).status_code == 404


def test_nobody_reads_without_credentials(client, event):
    assert client.get("/api/v1/events").status_code == 401
    assert client.get(f"/api/v1/events/{event['id']}/evidence.zip").status_code == 401


def test_revisions_and_their_difference(admin, event):
    history = admin.get(f"/api/v1/events/{event['id']}/revisions").raise_for_status().json()
    assert [r["number"] for r in history["revisions"]] == list(range(1, event["revision"] + 1))
    diff = admin.get(f"/api/v1/events/{event['id']}/diff", params={"before": 1}).raise_for_status().json()
    assert (diff["same_input"], diff["same_algorithm"]) == (False, True)
    assert "inputs.sha256" in [d["path"] for d in diff["differences"]]
    assert admin.get(f"/api/v1/events/{event['id']}/diff", params={"before": 99}).status_code == 404


@pytest.mark.both_databases
def test_review_and_hold_are_remembered(admin, event):
    url = f"/api/v1/events/{event['id']}"
    said = admin.put(f"{url}/review", json={"verdict": "confirmed", "note": "seen"}).raise_for_status().json()
    assert said["review"]["verdict"] == "confirmed"
    assert admin.put(f"{url}/hold", json={"held": True, "reason": "claim 17"}).json()["hold"]["held"]
    assert not admin.put(f"{url}/hold", json={"held": False, "reason": "closed"}).json()["hold"]["held"]
    assert admin.put(f"{url}/review", json={"verdict": "perhaps"}).status_code == 422
    actions = admin.get(f"{url}/revisions").json()["actions"]
    assert sorted(a["action"] for a in actions) == ["confirmed", "held", "released"]
    assert {a["actor"] for a in actions} == {"administrator's token"}


def test_a_held_or_confirmed_event_is_not_withdrawn(admin, world, event):
    admin.put(f"/api/v1/events/{event['id']}/hold", json={"held": True, "reason": "claim 17"})
    world.reconstructor.events = []
    world.put(cut(drive_of(Leg(100, 12.0), Leg(60, 0.0)), seconds=40.0)[2], 9, stream="burst")
    world.bring_up()
    assert admin.get(f"/api/v1/events/{event['id']}").json()["withdrawn_at"] is None


def test_the_element_table(admin, event):
    url = f"/api/v1/events/{event['id']}"
    elements = admin.get(f"{url}/edr.json").raise_for_status().json()["elements"]
    by_name = {e["name"]: e for e in elements}
    assert by_name["Safety belt status, driver"]["values"] == "not recorded"
    assert by_name["Maximum delta-V, longitudinal"]["values"] == [pytest.approx(-30.1, abs=0.5)]
    rows = list(csv.DictReader(io.StringIO(admin.get(f"{url}/edr.csv").raise_for_status().text)))
    assert {row["element"] for row in rows} == set(by_name)
    assert any(row["value"] == "not recorded" for row in rows)


def test_the_trace_in_three_formats(admin, event):
    url = f"/api/v1/events/{event['id']}/trace"
    table = pq.read_table(io.BytesIO(admin.get(url).raise_for_status().content))
    t = table.column("t").to_numpy()
    assert (t.min(), t.max()) == (pytest.approx(T0 - 30.0, abs=0.1), pytest.approx(T0 + 30.0, abs=0.1))
    rows = list(csv.DictReader(io.StringIO(admin.get(url, params={"format": "csv"}).raise_for_status().text)))
    assert len(rows) == table.num_rows
    recording = make_reader(io.BytesIO(admin.get(url, params={"format": "mcap"}).raise_for_status().content))
    topics = [channel.topic for _, channel, _ in recording.iter_messages()]
    assert topics.count("/box/inertial") == sum(row["fx"] != "" for row in rows)
    assert topics.count("/box/gnss") == sum(row["speed"] != "" for row in rows)
    first = next(message for _, _, message in recording.iter_messages())
    assert first.log_time / 1e9 == pytest.approx(1_772_366_520.25 - 30.0, abs=0.2)
    assert admin.get(url, params={"format": "xlsx"}).status_code == 422


def test_the_report_of_a_revision_stays_the_same_when_things_are_renamed(world, admin, event):
    url = f"/api/v1/events/{event['id']}/report.pdf"
    before, archive = admin.get(url).content, f"/api/v1/events/{event['id']}/evidence.zip"
    reports = zipped(admin.get(archive).content, "report-en.pdf")
    with world.database.transaction() as session:
        device = session.get_one(Device, event["device_id"])
        device.name = "Renamed since"
        vehicle = Vehicle(
            organisation_id=device.organisation_id, name="Fiat Panda", vehicle_class="car", created_at=device.created_at
        )
        session.add(vehicle)
        session.flush()
        session.get_one(Event, event["id"]).vehicle_id = vehicle.id
    assert admin.get(url).content == before
    assert zipped(admin.get(archive).content, "report-en.pdf") == reports
    # What is computed from then on has the names of then.
    world.reconstructor.events = [crash(T0, status="settling")]
    again = reprocess(world.database, world.store, event["id"], clock=world.clock, reconstructor=world.reconstructor)
    assert again.outcome == "revised"
    revisions = world.rows(EventRevision, EventRevision.number)
    newest = [row for row in revisions if row.event_id == event["id"]][-1]
    assert (newest.device_name, newest.vehicle_name, newest.plate) == ("Renamed since", "Fiat Panda", None)
    assert admin.get(url, params={"revision": again.revision - 1}).content == before


def zipped(content: bytes, name: str) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read(name)


def test_the_report_in_two_languages_is_the_same_each_time(admin, event):
    url = f"/api/v1/events/{event['id']}/report.pdf"
    english, again = admin.get(url).raise_for_status(), admin.get(url)
    assert english.headers["content-type"] == "application/pdf"
    assert english.content == again.content
    assert english.content.startswith(b"%PDF-")
    assert 3 <= english.content.count(b"/Type /Page\n") <= 5
    italian = admin.get(url, params={"lang": "it"}).raise_for_status().content
    assert italian != english.content
    assert admin.get(url, params={"lang": "fr"}).status_code == 422
    assert admin.get(url, params={"revision": 1}).content != english.content


@pytest.fixture
def evidence(admin, event, tmp_path):
    path = tmp_path / "evidence.zip"
    path.write_bytes(admin.get(f"/api/v1/events/{event['id']}/evidence.zip").raise_for_status().content)
    return path


def altered(source, target, name, change) -> None:
    with zipfile.ZipFile(source) as bundle, zipfile.ZipFile(target, "w") as out:
        for entry in bundle.namelist():
            data = bundle.read(entry)
            out.writestr(entry, change(data) if entry == name else data)


def test_the_archive_verifies_with_python_alone(evidence, tmp_path, capsys):
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(evidence) as bundle:
        bundle.extractall(folder)
        names = bundle.namelist()
    assert {"event.json", "report-en.pdf", "chain.json", "verify.py", "raw/1.columns", "raw/1.csv"} <= set(names)
    run = subprocess.run(
        [sys.executable, "-I", "-S", folder / "verify.py"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "Everything holds." in run.stdout
    assert main(["verify", str(evidence), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["passed"]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("raw/1.columns", lambda data: data[:-1] + bytes([data[-1] ^ 1])),
        ("event.json", lambda data: data.replace(b'"kind":"crash"', b'"kind":"Crash"')),
        ("report-en.pdf", lambda data: data + b"%"),
        ("chain.json", lambda data: data.replace(b'"sequence": 1', b'"sequence": 8')),
        ("manifest.json", lambda data: data[:0] + b"{}"),
    ],
)
def test_an_altered_archive_does_not_hold(evidence, tmp_path, capsys, name, change):
    other = tmp_path / "other.zip"
    altered(evidence, other, name, change)
    assert main(["verify", str(other)]) == 1
    assert "WRONG" in capsys.readouterr().out


def test_the_archive_is_the_same_each_time(admin, event, evidence):
    assert admin.get(f"/api/v1/events/{event['id']}/evidence.zip").content == evidence.read_bytes()


def test_scatola_verify_recomputes_the_chain(world, settings, monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    assert main(["verify", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["devices"]
    revisions = world.rows(EventRevision, EventRevision.number)
    assert (told["links"], told["revisions"], told["faults"]) == (4, len(revisions), [])
    blob = settings.data_dir / "blobs" / world.rows(Batch, Batch.chain_index)[1].blob_key
    content = blob.read_bytes()
    blob.unlink()
    assert main(["verify", "--device", world.device_id]) == 1
    assert "link 1: raw data are missing" in capsys.readouterr().out
    blob.write_bytes((settings.data_dir / "blobs" / world.rows(Batch, Batch.chain_index)[2].blob_key).read_bytes())
    assert main(["verify"]) == 1
    assert "not what was uploaded" in capsys.readouterr().out
    blob.write_bytes(content)
    with world.database.transaction() as session:
        session.get(Batch, world.rows(Batch, Batch.chain_index)[2].id).boot = "other"
    assert main(["verify"]) == 1
    assert "link 2 does not follow" in capsys.readouterr().out


def test_scatola_verify_recomputes_every_revision_of_an_event(world, settings, monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    row = world.rows(EventRevision, EventRevision.number)[0]
    body = world.rows(Batch, Batch.chain_index)[1]
    changed = canonical_bytes(row).replace(b'"algorithm":"', b'"algorithm":"x')
    for document, fault in (
        (zstandard.compress(changed), "is not what was computed"),
        (row.document[:-9], "cannot be read"),
        (b"", "cannot be read"),
    ):
        with world.database.transaction() as session:
            session.get(EventRevision, row.id).document = document
        assert main(["verify"]) == 1
        assert f"revision {row.number} of event {row.event_id} {fault}" in capsys.readouterr().out
    with world.database.transaction() as session:
        stored = session.get(EventRevision, row.id)
        stored.document, stored.input_sha256 = row.document, "0" * 64
        session.get(Batch, body.id).body_key = "nowhere"
    assert main(["verify"]) == 1
    told = capsys.readouterr().out
    assert "its inputs are not those that it names" in told
    assert "link 1: the body is missing" in told


def test_the_collector_leaves_what_events_rest_on(world, clock):
    clock.advance(days=400)
    assert collect(world.store, world.database, clock()) == 0


def test_reprocessing_says_the_same_or_makes_a_revision(world, admin, event, clock):
    def again():
        return reprocess(world.database, world.store, event["id"], clock=clock, reconstructor=world.reconstructor)

    assert severe_events(world.database, None) == [event["id"]]
    assert (again().outcome, world.rows(Event, Event.at)[1].revision) == ("same", event["revision"])
    world.reconstructor.events = [crash(T0, utc_t0=1_772_366_521.0)]
    result = again()
    assert (result.outcome, result.revision) == ("revised", event["revision"] + 1)
    assert result.differences == ("event.basis.utc_t0",)
    assert admin.get(f"/api/v1/events/{event['id']}").json()["revision"] == event["revision"] + 1
    world.reconstructor.events = []
    assert again().outcome == "gone"


def test_the_api_keeps_the_body_of_a_batch_that_may_hold_a_blow(client, make_device, database):
    _, token = make_device()

    def send(sequence, force):
        body = {"columns": {"t": [0.0, 0.1], "fx": [0.0, force], "fy": [0.0, 0.0], "fz": [-9.8, -9.8]}}
        headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": f"b/{sequence}"}
        assert httpx.post(f"{client.base_url}/api/v1/batches", json=body, headers=headers).status_code == 202

    send(0, 3.0)
    send(1, 30.0)
    with database.reading() as session:
        kept = [b.body_key is not None for b in session.query(Batch).order_by(Batch.sequence)]
    assert kept == [False, True]


def test_another_tenants_event_is_not_found(admin, database, clock, event):
    clock.advance(seconds=1.0)  # the oldest organisation is the administrator's
    with database.transaction() as session:
        other = Organisation(name="other", created_at=clock())
        session.add(other)
        session.flush()
        register(session, other.id, DeviceIn(name="x"), idempotency_key=None, now=clock())
        session.get(Event, event["id"]).organisation_id = other.id
    assert admin.get(f"/api/v1/events/{event['id']}").status_code == 404
    assert admin.get("/api/v1/events").json()["items"][0]["kind"] == "harsh_braking"
