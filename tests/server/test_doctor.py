from __future__ import annotations

import datetime as dt
import json

import pytest
from fleet_world import Leg, World, cut, drive_of

from server.cli.main import main
from server.jobs.failures import MAX_FAILURES, Job, note_failure
from server.models import Analysis, Batch, Change
from server.operations.doctor import Doctor


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    settings.data_dir.chmod(0o700)
    world = World(database, settings, clock, organisation)
    for k, batch in enumerate(cut(drive_of(Leg(30, 10.0)))):
        world.put(batch, k)
    world.settle()
    return world


def faults(settings, now) -> dict[str, str]:
    found = list(Doctor(settings, now).findings())
    assert len({finding.check for finding in found}) == 12
    return {finding.check: finding.detail for finding in found if finding.status == "fault"}


@pytest.mark.both_databases
@pytest.mark.usefixtures("world")
def test_a_healthy_installation_has_no_fault(settings, clock):
    assert faults(settings, clock()) == {}


def test_it_says_what_is_wrong_and_leaves_with_a_status(world, settings, clock, monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    secrets = tmp_path / "secrets"
    secrets.mkdir()
    (secrets / "scatola_admin_token").write_text("very-secret")
    (secrets / "scatola_admin_token").chmod(0o644)
    monkeypatch.setenv("SCATOLA_SECRETS_DIR", str(secrets))
    lost, damaged = (each.blob_key for each in world.rows(Batch, Batch.sequence)[:2])
    (world.store._root / lost).unlink()
    (world.store._root / damaged).write_bytes(b"no parquet")
    with world.database.transaction() as session:
        for _ in range(MAX_FAILURES):
            note_failure(session, Job("j", world.device_id, "devices", {}), ValueError("x"), now=clock())
        future = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
        session.add(Change(at=future, organisation_id=world.organisation.id, kind="x"))
    assert main(["doctor", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["healthy"] is False
    wrong = {finding["check"] for finding in told["findings"] if finding["status"] == "fault"}
    assert wrong == {"blobs", "work", "clock", "secrets", "evidence"}
    assert "very-secret" not in json.dumps(told)


def test_a_database_that_was_never_made(settings, tmp_path, clock):
    folder = tmp_path / "none"
    folder.mkdir(mode=0o700)
    found = faults(settings.model_copy(update={"data_dir": folder}), clock())
    assert "run `scatola migrate`" in found["migrations"]


def test_settings_that_are_wrong_are_named_but_not_repeated(monkeypatch, capsys):
    monkeypatch.setenv("SCATOLA_PORT", "hunter2")
    assert main(["doctor"]) == 1
    told = capsys.readouterr().err
    assert "SCATOLA_PORT" in told
    assert "hunter2" not in told


def test_files_of_the_workbench_are_no_orphans(world, settings, clock):
    keys = [f"{world.organisation.id}/workbench/{name}" for name in ("in.input", "lost.input")]
    for key in keys:
        world.store.put(key, b"x")
    with world.database.transaction() as session:
        session.add(
            Analysis(
                organisation_id=world.organisation.id,
                creator="ada",
                kind="allan",
                name="rest",
                parameters={},
                created_at=clock(),
                input_key=keys[0],
            )
        )
    later = dt.datetime.now(dt.UTC) + dt.timedelta(days=2)
    (told,) = [f.detail for f in Doctor(settings, later).findings() if f.check == "blobs" and f.status == "warning"]
    assert told.startswith("1 of ")
