"""Bulk export: all of it, and no one else's; written down, and in bounded memory."""

from __future__ import annotations

import datetime as dt
import io

import numpy as np
import pyarrow.parquet as pq
import pytest
import sqlalchemy as sa
from crash_world import crash
from test_tenants import Tenants, fill

from server.bulk import service
from server.cli.main import main
from server.events.canonical import settle
from server.events.result import event_json
from server.formats.columns import Columns
from server.models import AuditEntry, Batch, Event, TrackPoint, Trip
from server.store import open_store

AT = dt.datetime(2026, 3, 1, 12, 0, tzinfo=dt.UTC)


@pytest.fixture
def tenants(database, settings) -> Tenants:
    store = open_store(settings)
    with database.transaction() as session:
        return Tenants(database, fill(session, store, "a"), fill(session, store, "b"))


def table(content: bytes):
    return pq.read_table(io.BytesIO(content))


@pytest.mark.both_databases
def test_tracks_events_and_samples_of_one_organisation(admin, tenants):
    mine = tenants.mine
    tracks = admin.get("/api/v1/export/tracks")
    assert tracks.headers["content-type"] == "application/vnd.apache.parquet"
    assert tracks.headers["content-disposition"].endswith('.parquet"')
    assert table(tracks.content).to_pylist() == [
        {
            "trip_id": mine["trip"],
            "device_id": mine["device"],
            "vehicle_id": mine["vehicle"],
            "at": AT,
            "t_s": 0.0,
            "lat_deg": 45.0,
            "lon_deg": 11.0,
            "alt_m": None,
            "speed_mps": None,
            "course_rad": None,
        }
    ]
    (event,) = table(admin.get("/api/v1/export/events").content).to_pylist()
    told = settle(event_json(crash(0.5)))
    assert (event["event_id"], event["kind"], event["severe"]) == (mine["event"], told["kind"], True)
    assert event["delta_v_resultant_kmh"] == pytest.approx(told["delta_v_kmh"]["resultant"])
    samples = table(admin.get("/api/v1/export/samples").content)
    assert samples.schema.names == service.SAMPLES.names
    rows = samples.to_pylist()
    assert [(row["device_id"], row["t"], row["fx"], row["wx"]) for row in rows] == [
        (mine["device"], 0.0, 0.0, None),
        (mine["device"], 1.0, 0.0, None),
    ]
    assert rows[1]["unix_s"] == 1.0
    with tenants.database.reading() as session:
        entries = session.execute(sa.select(AuditEntry.subject).where(AuditEntry.action == "export")).scalars().all()
    assert entries == ["tracks", "events", "samples"]


def test_a_time_and_a_box_narrow_it(admin, tenants):
    late = {"from": "2026-03-02T00:00:00Z"}
    for kind in service.KINDS:
        assert table(admin.get(f"/api/v1/export/{kind}", params=late).content).num_rows == 0
        other = admin.get(f"/api/v1/export/{kind}", params={"device": tenants.theirs["device"]})
        assert table(other.content).num_rows == 0
        whole = {"from": "1970-01-01T00:00:00Z", "to": "2026-04-01T00:00:00Z", "device": tenants.mine["device"]}
        assert table(admin.get(f"/api/v1/export/{kind}", params=whole).content).num_rows > 0


def test_many_trips_and_batches_come_in_bounded_groups(database, settings, tenants, monkeypatch):
    monkeypatch.setattr(service, "GROUP_ROWS", 1000)
    monkeypatch.setattr(service, "_PAGE", 7)
    store, mine = open_store(settings), tenants.mine
    columns = Columns({"t": np.arange(100.0), **dict.fromkeys(("fx", "fy", "fz"), np.arange(100.0))})
    with database.transaction() as session:
        trip, batch = session.get_one(Trip, mine["trip"]), session.scalars(sa.select(Batch)).first()
        for k in range(50):
            own = {c.key: getattr(trip, c.key) for c in Trip.__table__.columns} | {"id": f"trip{k:028d}"}
            session.add(Trip(**own))
            session.flush()
            session.add_all(
                TrackPoint(trip_id=own["id"], t_s=float(t), at=AT, lat_deg=45.0, lon_deg=11.0) for t in range(100)
            )
            copy = {c.key: getattr(batch, c.key) for c in Batch.__table__.columns}
            key = f"{mine['organisation']}/many"
            session.add(Batch(**copy | {"id": f"{k:032d}", "sequence": k + 1, "chain_index": k + 1, "blob_key": key}))
        session.get_one(Batch, f"{5:032d}").blob_key = "gone/gone"
    store.put(f"{mine['organisation']}/many", columns.to_parquet())
    confined = database.confined_to(mine["organisation"])
    for kind, rows in (("tracks", 5001), ("samples", 49 * 100 + 2)):
        pieces = list(service.export(confined, store, service.Wanted(kind)))
        assert len([piece for piece in pieces if piece]) > 4
        file = pq.ParquetFile(io.BytesIO(b"".join(pieces)))
        assert file.metadata.num_rows == rows
        assert max(file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)) <= 1100
        if kind == "samples":
            assert file.metadata.metadata[b"batches_without_data"] == b"1"
            ids = file.read(["batch_id"])["batch_id"].to_pylist()
            assert len(set(ids)) == 50


def test_what_is_being_erased_is_not_given_out_while_its_blob_is_still_there(admin, tenants):
    with tenants.database.transaction() as session:
        session.execute(sa.update(Batch).values(erasing_at=AT))
    file = pq.ParquetFile(io.BytesIO(admin.get("/api/v1/export/samples").content))
    assert file.metadata.num_rows == 0
    assert file.metadata.metadata[b"batches_without_data"] == b"1"
    assert admin.get(f"/api/v1/devices/{tenants.mine['device']}/level").json()["received_at"] is None


def test_the_command_writes_a_whole_file_or_none(tenants, settings, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(settings.data_dir))
    out = tmp_path / "events.parquet"
    assert main(["export", "events", str(out)]) == 1
    assert "--organisation" in capsys.readouterr().err
    assert not out.exists()
    mine = tenants.mine["organisation"]
    assert main(["export", "events", str(out), "--organisation", mine, "--from", "1970-01-01"]) == 0
    assert pq.read_table(out)["event_id"].to_pylist() == [tenants.mine["event"]]
    with tenants.database.reading() as session:
        assert session.scalars(sa.select(Event.id)).all()
        names = session.scalars(sa.select(AuditEntry.actor_name).where(AuditEntry.action == "export")).all()
    assert names == ["command line"]
