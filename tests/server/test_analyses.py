"""Analyses: asked for over HTTP, worked off by a process of the worker's, seen and deleted by who may."""

from __future__ import annotations

import datetime as dt
import json
import sys
import threading

import numpy as np
import pytest
import sqlalchemy as sa
from fastapi import FastAPI

from nav_core.rotation import thesis_to_matrix
from nav_core.simulate import Scenario, simulate
from server.analyses import queries, service
from server.analyses.kinds import checked
from server.analyses.routes import MAX_FILE_BYTES
from server.errors import InvalidError
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.formats.tables import write_csv
from server.jobs.analyses import Runner, work_off
from server.jobs.work import bring_up_to_date
from server.models import Analysis, AuditEntry, Change
from server.store import collect
from tests.conftest import ADMIN_TOKEN
from tests.recordings import folder

PATH = "/api/v1/analyses"


def noise(rows: int = 2000) -> Columns:
    """A sensor at rest."""
    rng = np.random.default_rng(7)
    return Columns(
        {
            "t": 0.01 * np.arange(rows),
            "fx": 0.02 * rng.standard_normal(rows),
            "fy": 0.02 * rng.standard_normal(rows),
            "fz": -9.81 + 0.02 * rng.standard_normal(rows),
        }
    )


def poses(directions: np.ndarray) -> bytes:
    """Mean readings of an accelerometer with bias and scales, as text."""
    truth = 9.80665 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    readings = truth @ np.diag([1.01, 0.99, 1.02]) + [0.1, -0.2, 0.05]
    readings += 1e-3 * np.random.default_rng(1).standard_normal(readings.shape)
    columns = {"t": np.arange(len(readings), dtype=float), "fx": readings[:, 0], "fy": readings[:, 1]}
    return write_csv(Columns({**columns, "fz": readings[:, 2]}))


def ask(client, kind: str, body: bytes = b"", **query):
    return client.post(PATH, params={"kind": kind, **query}, content=body)


@pytest.fixture
def work(app: FastAPI, database, clock):
    """Work off everything that is due, in this process."""

    def run() -> None:
        while True:
            with database.reading() as session:
                due = queries.due(session, now=clock())
            if due is None:
                return
            with database.transaction() as session:
                row = service.claim(session, due, now=clock())
            if row is not None:
                work_off(database, app.state.store, due, row.attempts, clock=clock)

    return run


def test_an_analysis_is_asked_for_worked_off_and_read(admin, work, database):
    answer = ask(admin, "allan", noise().to_parquet(), name="rest.parquet", parameters='{"terms": "N"}')
    assert answer.status_code == 202, answer.text
    asked = answer.json()
    assert (asked["status"], asked["kind"], asked["name"]) == ("waiting", "allan", "rest.parquet")
    path = f"{PATH}/{asked['id']}"
    refused = admin.get(f"{path}/result")
    assert (refused.status_code, refused.json()["code"]) == (409, "no_result")
    work()
    told = admin.get(path).json()
    assert (told["status"], told["progress"], told["attempts"], told["error"]) == ("done", 1.0, 1, None)
    result = admin.get(f"{path}/result")
    document = result.json()
    assert result.headers["content-disposition"].endswith(f'allan-{asked["id"]}.json"')
    assert document["input_sha256"] == told["input_sha256"]
    assert document["columns"]["fx"]["N"]["value"] == pytest.approx(0.02 * 0.01**0.5, rel=0.1)
    assert document["columns"]["fx"]["K"]["value"] is None
    assert [one["id"] for one in admin.get(PATH).json()["items"]] == [asked["id"]]
    # Another look at the same recording needs no second upload.
    again = ask(admin, "allan", again=asked["id"], parameters='{"terms": "NB"}').json()
    assert again["input_sha256"] == told["input_sha256"]
    work()
    assert admin.get(f"{PATH}/{again['id']}/result").json()["terms"] == "NB"
    with database.reading() as session:
        changes = session.scalars(sa.select(Change).where(Change.kind == "analysis").order_by(Change.id)).all()
        looks = session.scalars(sa.select(AuditEntry.subject).where(AuditEntry.action == "raw.read")).all()
    assert [change.data["status"] for change in changes if change.data["analysis_id"] == asked["id"]][-1] == "done"
    assert f"{PATH}/{{analysis_id}}/result analysis_id={asked['id']}" in looks
    page = admin.get(f"/workbench/{asked['id']}").text
    assert "rest.parquet" in page
    assert "graph-band" in page
    assert asked["id"] in admin.get("/workbench").text


def test_poses_that_do_not_suffice_are_refused_with_a_picture(admin, work):
    few = ask(admin, "accelerometer", poses(np.eye(3)), parameters='{"rows_are_poses": true}').json()
    grid = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
    many = ask(admin, "accelerometer", poses(grid), parameters='{"rows_are_poses": true}').json()
    work()
    document = admin.get(f"{PATH}/{few['id']}/result").json()
    assert document["status"] == "refused"
    assert "3 poses do not suffice" in document["refusal"]
    assert document["largest_hole_deg"] > 100.0
    page = admin.get(f"/workbench/{few['id']}").text
    assert "3 poses do not suffice" in page
    assert "graph-poses" in page
    document = admin.get(f"{PATH}/{many['id']}/result").json()
    assert document["status"] == "calibrated"
    bias = {entry["name"]: entry for entry in document["parameters"]}
    assert len(bias) == 9
    assert document["bias"] == pytest.approx([0.1, -0.2, 0.05], abs=5e-3)
    assert document["rms_after"] < 5e-3 < document["rms_before"]
    assert document["largest_hole_deg"] < 40.0
    assert "graph-dots" in admin.get(f"/workbench/{many['id']}").text


def test_a_file_that_is_none_gets_the_clear_error(admin, work):
    for kind, body, words in (
        ("allan", b"no drive at all", "is no drive file"),
        ("allan", b"t,fx\n0,1\n", "come together"),
        ("track", noise().to_parquet(), "does not tell the mounting"),
        ("magnetometer", noise().to_parquet(), "no samples in the columns mx, my, mz"),
    ):
        asked = ask(admin, kind, body, name="bad.bin").json()
        work()
        told = admin.get(f"{PATH}/{asked['id']}").json()
        assert told["status"] == "failed"
        assert words in told["error"], told["error"]
        assert words in admin.get(f"/workbench/{asked['id']}").text


@pytest.mark.parametrize(
    ("query", "body", "status"),
    [
        ({"kind": "horoscope"}, b"x", 422),
        ({"kind": "allan", "parameters": "{"}, b"x", 422),
        ({"kind": "allan", "parameters": '{"terms": "XYZ"}'}, b"x", 422),
        ({"kind": "allan", "parameters": '{"colour": 1}'}, b"x", 422),
        ({"kind": "gyro"}, b"x", 422),
        ({"kind": "mounting", "parameters": '{"methods": ["online", "online"]}'}, b"x", 422),
        ({"kind": "track", "parameters": '{"outage_s": NaN}'}, b"x", 422),
        ({"kind": "allan"}, b"", 422),
        ({"kind": "allan", "trip": "x" * 32}, b"", 404),
        ({"kind": "allan", "again": "x" * 32}, b"", 404),
        ({"kind": "allan", "trip": "x" * 32, "again": "x" * 32}, b"", 422),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_stored(admin, database, query, body, status):
    answer = admin.post(PATH, params=query, content=body)
    assert answer.status_code == status, answer.text
    with database.reading() as session:
        assert session.scalars(sa.select(Analysis)).all() == []


def test_a_file_that_is_too_large_is_refused_while_it_comes(admin):
    def chunks():
        for _ in range(MAX_FILE_BYTES // 2**20 + 2):
            yield b"\0" * 2**20

    assert admin.post(PATH, params={"kind": "allan"}, content=chunks()).status_code == 413


def test_there_is_an_end_to_what_an_organisation_keeps(admin, monkeypatch):
    monkeypatch.setattr(service, "MOST_WAITING", 1)
    assert ask(admin, "allan", b"x").status_code == 202
    assert ask(admin, "allan", b"x").status_code == 429
    monkeypatch.setattr(service, "MOST", 1)
    full = ask(admin, "allan", b"x")
    assert (full.status_code, full.json()["code"]) == (409, "too_many_analyses")
    monkeypatch.setattr(service, "MOST", 9)
    monkeypatch.setattr(service, "MOST_BYTES", 1)
    assert ask(admin, "allan", b"x").status_code == 413


def test_an_analysis_can_be_cancelled_and_deleted_and_its_blobs_go(admin, app, database, work):
    asked = ask(admin, "allan", noise().to_parquet()).json()
    path = f"{PATH}/{asked['id']}"
    assert admin.delete(path).status_code == 409
    assert admin.post(f"{path}/cancel").json()["status"] == "cancelled"
    work()
    assert admin.get(path).json()["attempts"] == 0
    again = ask(admin, "allan", again=asked["id"]).json()
    work()
    assert admin.post(f"{PATH}/{again['id']}/cancel").json()["status"] == "done"
    later = dt.datetime.now(dt.UTC) + dt.timedelta(days=2)
    assert collect(app.state.store, database, later) == 0
    assert admin.delete(path).status_code == 204
    assert collect(app.state.store, database, later) == 0  # the second has the same recording
    assert admin.delete(f"{PATH}/{again['id']}").status_code == 204
    assert collect(app.state.store, database, later) == 2
    assert admin.get(path).status_code == 404


# --- the worker's side


@pytest.mark.both_databases
def test_only_the_attempt_that_holds_an_analysis_may_write(admin, database, clock):
    asked = ask(admin, "allan", noise().to_parquet()).json()["id"]
    with database.transaction() as session:
        first = service.claim(session, asked, now=clock())
    with database.transaction() as session:
        assert service.claim(session, asked, now=clock()) is None  # held
        assert queries.due(session, now=clock()) is None
    clock.advance(seconds=40)
    with database.transaction() as session:
        assert queries.due(session, now=clock()) == asked  # whoever held it is gone
        second = service.claim(session, asked, now=clock())
    assert (first.attempts, second.attempts) == (1, 2)
    with database.transaction() as session:
        assert not service.finish(session, first, 1, {"status": "failed", "error": "late"}, now=clock())
        assert not service.renew(session, asked, 1, now=clock())
        assert not service.report(session, first, 1, "x", 0.5, now=clock())
        assert service.renew(session, asked, 2, now=clock())
        assert service.report(session, second, 2, "half", 0.5, now=clock())
    assert admin.get(f"{PATH}/{asked}").json()["stage"] == "half"
    assert admin.post(f"{PATH}/{asked}/cancel").json()["status"] == "cancelled"
    with database.transaction() as session:
        assert not service.finish(session, second, 2, {"status": "done"}, now=clock())
    assert admin.get(f"{PATH}/{asked}").json()["status"] == "cancelled"


class Watching:
    """A runner with processes of the test's own."""

    def __init__(self, settings, database, clock, code: str, **options) -> None:
        self.stop = threading.Event()
        command = [sys.executable, "-c", code]
        self._runner = Runner(settings, database, clock, command=lambda *_: command, **options)

    def once(self) -> bool:
        return self._runner.once(self.stop)


def test_a_process_that_dies_is_tried_again_and_then_given_up(admin, settings, database, clock):
    asked = ask(admin, "allan", b"x").json()["id"]
    runner = Watching(settings, database, clock, "raise SystemExit(9)")
    for attempt in (1, 2, 3):
        assert runner.once()
        told = admin.get(f"{PATH}/{asked}").json()
        assert (told["status"], told["attempts"]) == ("waiting", attempt)
    assert runner.once()
    told = admin.get(f"{PATH}/{asked}").json()
    assert told["status"] == "failed"
    assert "ended its worker 3 times" in told["error"]
    assert not runner.once()


def test_a_process_that_takes_too_long_is_ended(admin, settings, database, clock):
    asked = ask(admin, "allan", b"x").json()["id"]
    assert Watching(settings, database, clock, "import time; time.sleep(60)", limit_s=0.2).once()
    told = admin.get(f"{PATH}/{asked}").json()
    assert told["status"] == "failed"
    assert "took longer" in told["error"]


def test_a_cancelled_process_is_ended(admin, settings, database, clock):
    asked = ask(admin, "allan", b"x").json()["id"]
    runner = Watching(settings, database, clock, "import time; time.sleep(60)", renew_s=0.1)
    done = threading.Thread(target=runner.once)
    done.start()
    while admin.get(f"{PATH}/{asked}").json()["status"] != "running":
        pass
    admin.post(f"{PATH}/{asked}/cancel").raise_for_status()
    done.join(20.0)
    assert not done.is_alive()
    assert admin.get(f"{PATH}/{asked}").json()["status"] == "cancelled"


def test_a_worker_that_stops_gives_its_analysis_back(admin, settings, database, clock):
    asked = ask(admin, "allan", b"x").json()["id"]
    runner = Watching(settings, database, clock, "import time; time.sleep(60)")
    done = threading.Thread(target=runner.once)
    done.start()
    while admin.get(f"{PATH}/{asked}").json()["status"] != "running":
        pass
    runner.stop.set()
    done.join(20.0)
    told = admin.get(f"{PATH}/{asked}").json()
    assert (told["status"], told["attempts"]) == ("waiting", 0)


def test_the_process_does_the_work_on_the_settings_of_its_worker(admin, settings, database, clock):
    """The real one, once: an interpreter of its own on the same database and store."""
    asked = ask(admin, "accelerometer", poses(np.eye(3)), parameters='{"rows_are_poses": true}').json()["id"]
    assert Runner(settings, database, clock).once(threading.Event())
    assert admin.get(f"{PATH}/{asked}").json()["status"] == "done"


# --- the page's form


@pytest.fixture
def browser(client):
    """A signed-in session that posts forms as a browser does."""
    csrf = client.post("/api/v1/auth/session", json={"code": ADMIN_TOKEN}).json()["csrf_token"]

    def post(typed: dict[str, str], body: bytes = b"", *, token: str = csrf, first: bool = True):
        fields = {"csrf_token": token, **typed} if first else {**typed, "csrf_token": token}
        files = {name: (None, value) for name, value in fields.items()} | {"file": ("rest.parquet", body)}
        return client.post("/workbench", files=files)

    return post


def test_the_form_asks_as_the_api_does(browser, admin, work):
    typed = {"kind": "allan", "terms": "N", "rate_hz": "99,5", "shortest_s": "", "window_s": "1", "outage_s": "30"}
    answer = browser(typed, noise().to_parquet())
    assert answer.status_code == 303, answer.text
    asked = answer.headers["location"].removeprefix("/workbench/")
    told = admin.get(f"{PATH}/{asked}").json()
    assert told["parameters"] == {"terms": "N", "rate_hz": 99.5, "shortest_s": 0.0}
    assert told["name"] == "rest.parquet"
    work()
    again = browser({"kind": "allan", "again": asked, "terms": "NB"})
    assert again.status_code == 303
    assert admin.get(f"{PATH}/{again.headers['location'][11:]}").json()["input_sha256"] == told["input_sha256"]
    gyro = browser({"kind": "gyro", "again": asked, "rates_deg_s": "50, 100;200", "window_s": "1"})
    parameters = admin.get(f"{PATH}/{gyro.headers['location'][11:]}").json()["parameters"]
    assert parameters == {"rates_deg_s": [50.0, 100.0, 200.0], "window_s": 1.0, "rows_are_poses": False}


def test_the_form_says_what_is_wrong(browser, admin):
    body = noise().to_parquet()
    for typed, sent, words in (
        ({"kind": "allan"}, b"", "Choose a file or a trip."),
        ({"kind": "allan", "rate_hz": "-1"}, body, "rate_hz"),
        ({"kind": "gyro"}, body, "rates_deg_s"),
        ({"kind": "horoscope"}, body, "not one of the list"),
    ):
        answer = browser(typed, sent)
        assert answer.status_code == 422
        assert words in answer.text
    assert browser({"kind": "allan"}, body, token="wrong").status_code == 403
    # The token stands before the file: nobody waits for 64 MB to learn that a form is forged.
    assert browser({"kind": "allan", "x": "x" * 70_000}, body, first=False).status_code == 403
    assert admin.get(PATH).json()["items"] == []


def test_a_form_that_is_too_large_is_refused(browser, admin):
    assert browser({"kind": "allan"}, b"\0" * (MAX_FILE_BYTES + 2**21)).status_code == 413
    assert admin.get(PATH).json()["items"] == []


# --- what comes out


@pytest.fixture(scope="module")
def drive():
    scenario = Scenario(
        route="urban", duration=240.0, accel_rate=50.0, with_gyro=True, R_va=thesis_to_matrix(0.3, -0.5, 1.2)
    )
    return simulate(scenario, seed=11)


def test_a_track_is_held_against_the_fixes_that_were_withheld(admin, work, drive):
    body = from_drive(drive[0]).to_parquet()
    asked = ask(admin, "track", body, parameters='{"outage_from_s": 100, "outage_s": 20}').json()["id"]
    outside = ask(admin, "track", again=asked, parameters='{"outage_from_s": 1000}').json()["id"]
    work()
    document = admin.get(f"{PATH}/{asked}/result").json()
    cost = document["rehearsal"]
    assert (cost["begin_s"], cost["end_s"]) == (100.0, 120.0)
    assert len(cost["t_s"]) == len(cost["error_m"]) == len(cost["ellipse95"]["long_m"]) > 10
    assert cost["largest_error_m"] < 40.0
    assert all(a >= b for a, b in zip(cost["with_fix95_m"], cost["ellipse95"]["long_m"], strict=True))
    page = admin.get(f"/workbench/{asked}").text
    assert page.count("<figure") == 5
    told = admin.get(f"{PATH}/{outside}").json()
    assert told["status"] == "failed"
    assert "must lie within the fixes" in told["error"]


def test_estimators_come_side_by_side_with_their_way(admin, work, drive):
    body = from_drive(drive[0]).to_parquet()
    asked = ask(admin, "mounting", body, parameters='{"methods": ["mekf", "two-phase", "whole-drive"]}').json()["id"]
    work()
    document = admin.get(f"{PATH}/{asked}/result").json()
    assert list(document["methods"]) == ["mekf", "two-phase", "whole-drive"]
    whole = document["methods"]["whole-drive"]
    assert whole["result"]["status"] == "ready"
    assert whole["apart_deg"] == 0.0
    course = whole["course"]
    assert len(course["t_s"]) == len(course["euler_deg"]["angles"]) == len(course["sigma_v_deg"]) > 5
    assert course["euler_deg"]["angles"][-1] == pytest.approx(
        [whole["result"]["euler_deg"][name] for name in ("theta", "phi", "psi")], abs=1e-6
    )
    # The way narrows: the first sigmas are wider than the last.
    assert max(course["sigma_v_deg"][0]) > max(course["sigma_v_deg"][-1])
    seen = document["observability"]
    assert len(seen["t_s"]) == len(seen["largest_eigenvalue"]) == len(seen["forward_mps2"])
    assert all(1.0 <= value <= 9.0 for value in seen["largest_eigenvalue"])
    page = admin.get(f"/workbench/{asked}")
    assert page.text.count("<figure") == 7
    assert "About z, down" in admin.get(f"/workbench/{asked}?show=apart").text


def test_a_trip_is_analysed_against_the_mounting_that_was_entered(
    admin, client, app, database, make_device, work, drive
):
    device, token = make_device()
    recording, truth = drive
    body = from_drive(recording).to_parquet()
    sent = client.post(
        "/api/v1/batches",
        content=body,
        headers={
            "Authorization": f"Bearer {token}",
            "Idempotency-Key": "b/0",
            "Content-Type": "application/vnd.apache.parquet",
        },
    )
    assert sent.status_code == 202, sent.text
    bring_up_to_date(database, app.state.store, device, clock=lambda: dt.datetime(2026, 3, 1, 13, tzinfo=dt.UTC))
    entered = {"mountings": [{"from": "2000-01-01T00:00:00Z", "R_va": truth.R_va.tolist()}]}
    admin.put(f"/api/v1/devices/{device}/reference", json=entered).raise_for_status()
    trips = admin.get("/api/v1/trips").json()["items"]
    asked = ask(admin, "mounting", trip=trips[0]["id"], parameters='{"methods": ["two-phase", "whole-drive"]}')
    assert asked.status_code == 202, asked.text
    work()
    document = admin.get(f"{PATH}/{asked.json()['id']}/result").json()
    assert document["reference"]["from"] == "given"
    assert 0.0 < document["methods"]["whole-drive"]["apart_deg"] < 3.0
    assert len(document["input_sha256"]) == 64


def test_parameters_are_checked_without_the_numerics():
    assert checked("track", "{}") == {"outage_from_s": None, "outage_s": 30.0, "smoothed": True}
    with pytest.raises(InvalidError, match="outage_s"):
        checked("track", json.dumps({"outage_s": -1.0}))


def test_real_poses_of_an_xsens(admin, work):
    rows = np.loadtxt(folder("imu-tk-xsens") / "xsens_acc.txt.gz")
    f = (rows[:, 1:] - 32768.0) * 9.81744 / 6700.0
    columns = Columns({"t": rows[:, 0], "fx": f[:, 0], "fy": f[:, 1], "fz": f[:, 2]})
    parameters = json.dumps({"gravity_mps2": 9.81744})
    asked = ask(admin, "accelerometer", columns.to_parquet(), parameters=parameters).json()["id"]
    work()
    document = admin.get(f"{PATH}/{asked}/result").json()
    assert document["poses"]["count"] == 38
    assert document["rms_after"] < 2e-3 < document["rms_before"]
