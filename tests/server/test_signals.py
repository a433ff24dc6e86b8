"""Signals of a window: what is read, thinned, turned and sent."""

from __future__ import annotations

import datetime as dt
import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from server.formats.columns import Columns
from server.models import Batch, Boot, Installation
from server.signals.decimate import Curve, broken_at, gaps, min_max
from server.signals.thin import BUCKET_S, Memory, thin
from server.store import blob_key

RATE_HZ = 50.0
BATCH_S = 10.0
R_VA = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def decode(body: bytes):
    (length,) = struct.unpack_from("<I", body)
    header = json.loads(body[4 : 4 + length])
    at, series = 4 + length, {}
    for group in header["groups"]:
        n = group["count"]
        t = np.frombuffer(body, "<f8", n, at)
        at += 8 * n
        for name in group["columns"]:
            series[name] = (t, np.frombuffer(body, "<f4", n, at))
            at += 4 * n
    assert at == len(body)
    return header, series


def batch_columns(begin: float) -> Columns:
    """Specific force that tells the time, and speed at 1 Hz."""
    t = begin + np.arange(0.0, BATCH_S, 1.0 / RATE_HZ)
    speed = np.where(np.arange(t.size) % int(RATE_HZ) == 0, 0.5 * t, np.nan)
    return Columns({"t": t, "fx": t, "fy": np.full(t.size, 2.0), "fz": np.full(t.size, -9.8), "speed": speed})


@pytest.fixture
def box(make_device, app, database, clock):
    """A box with a minute of data that ends now, less the fourth batch."""
    device_id, token = make_device()
    end = clock()
    offset = end.timestamp() - 60.0
    with database.transaction() as session:
        organisation_id = _organisation_of(session, device_id)
        session.add(
            Boot(
                device_id=device_id,
                boot="b1",
                ordinal=1,
                utc_offset_s=offset,
                utc_sigma_s=0.1,
                utc_source="gnss",
                arrival_offset_s=offset,
                t_first_s=0.0,
                t_last_s=60.0,
            )
        )
        for sequence in (0, 1, 2, 4, 5):
            columns = batch_columns(sequence * BATCH_S)
            key = blob_key(organisation_id, device_id, columns.column_sha256(), "parquet")
            app.state.store.put(key, columns.to_parquet())
            session.add(
                Batch(
                    organisation_id=organisation_id,
                    device_id=device_id,
                    stream="continuous",
                    boot="b1",
                    sequence=sequence,
                    media_type="application/json",
                    body_sha256=columns.column_sha256(),
                    column_sha256=columns.column_sha256(),
                    blob_key=key,
                    stored_bytes=1,
                    rows=columns.rows,
                    t_first_s=sequence * BATCH_S,
                    t_last_s=(sequence + 1) * BATCH_S - 1.0 / RATE_HZ,
                    received_at=end,
                    chain_index=sequence,
                    chain_sha256="0" * 64,
                )
            )
    return device_id, offset, token


def _organisation_of(session, device_id: str) -> str:
    from server.models import Device

    return session.get(Device, device_id).organisation_id


def get(admin, device_id, **query):
    answer = admin.get(f"/api/v1/devices/{device_id}/signals", params=query)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/octet-stream"
    return decode(answer.content)


def iso(unix_s: float) -> str:
    return dt.datetime.fromtimestamp(unix_s, dt.UTC).isoformat()


def test_a_window_gives_its_samples_on_its_own_axis(admin, box):
    device_id, offset, _ = box
    header, series = get(admin, device_id, **{"from": iso(offset + 5.0), "to": iso(offset + 8.0)})
    assert dt.datetime.fromisoformat(header["t0"]).timestamp() == pytest.approx(offset + 5.0)
    t, fx = series["fx"]
    assert t.size == 151
    np.testing.assert_allclose(fx, t + 5.0, rtol=1e-6)
    t, speed = series["speed"]
    np.testing.assert_allclose(t, [0.0, 1.0, 2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(speed, 0.5 * (t + 5.0), rtol=1e-6)
    assert header["units"] == {"fx": "m/s^2", "fy": "m/s^2", "fz": "m/s^2", "speed": "m/s"}
    assert header["gaps"] == []


def test_the_default_is_the_newest_minute_and_gaps_interrupt_the_line(admin, box):
    device_id, offset, _ = box
    header, series = get(admin, device_id)
    assert dt.datetime.fromisoformat(header["to"]).timestamp() == pytest.approx(offset + 60.0)
    ((before, after),) = header["gaps"]
    assert before == pytest.approx(29.98, abs=0.01)
    assert after == pytest.approx(40.0, abs=0.01)
    t, fx = series["fx"]
    (hole,) = np.flatnonzero(np.isnan(fx))
    assert before < t[hole] < after
    assert np.all(np.diff(t) > 0.0)


def test_thinning_keeps_extremes_and_bounds_the_answer(admin, box):
    device_id, _, _ = box
    header, series = get(admin, device_id, points=100, columns="fx")
    assert [group["columns"] for group in header["groups"]] == [["fx"]]
    t, fx = series["fx"]
    assert t.size <= 102
    assert np.nanmin(fx) == 0.0
    assert np.nanmax(fx) == pytest.approx(60.0, abs=0.021)


def test_vehicle_axes_where_the_mounting_is_known(admin, box, database, clock):
    device_id, offset, _ = box
    header, _ = get(admin, device_id, frame="v")
    assert header["frame"] == "a"
    with database.transaction() as session:
        session.add(
            Installation(
                device_id=device_id,
                began_at=dt.datetime.fromtimestamp(offset + 10.0, dt.UTC),
                beginning="first",
                updated_at=clock(),
                status="ready",
                result={"R_va": R_VA.tolist()},
                algorithm="test/1",
                input_sha256="0" * 64,
            )
        )
    header, series = get(admin, device_id, frame="v", columns="fy,fx")
    assert header["frame"] == "v"
    t, fx = series["fx"]
    known = ~np.isnan(fx)
    assert t[known][0] == pytest.approx(10.0, abs=0.021)
    np.testing.assert_allclose(fx[known], 2.0)
    fy = series["fy"][1]
    np.testing.assert_allclose(fy[known], -t[known], atol=0.1)


def test_what_cannot_be_answered(admin, client, box):
    device_id, offset, token = box
    path = f"/api/v1/devices/{device_id}/signals"
    assert client.get(path).status_code == 401
    assert client.get(path, headers={"Authorization": f"Bearer {token}"}).status_code == 403
    assert admin.get(f"/api/v1/devices/{'0' * 32}/signals").status_code == 404
    for query, code in (
        ({"columns": "fx,nonsense"}, "unknown_column"),
        ({"from": "2026-01-01T00:00:00", "to": "2026-01-01T01:00:00Z"}, "naive_time"),
        ({"from": iso(offset + 5.0), "to": iso(offset + 5.0)}, "empty_window"),
    ):
        answer = admin.get(path, params=query)
        assert answer.status_code == 422, query
        assert answer.json()["code"] == code
    assert admin.get(path, params={"points": 10**6}).status_code == 422


def test_a_window_with_too_many_samples_is_refused(admin, box, monkeypatch):
    monkeypatch.setattr("server.signals.queries.MAX_ROWS", 1000)
    device_id, _, _ = box
    answer = admin.get(f"/api/v1/devices/{device_id}/signals")
    assert answer.status_code == 422
    assert answer.json()["code"] == "window_too_long"


def test_a_box_without_data_gives_empty_columns(admin, make_device):
    device_id, _ = make_device(name="new")
    header, series = get(admin, device_id)
    assert [group["count"] for group in header["groups"]] == [0, 0]
    assert series["fx"][0].size == 0


values = arrays(np.float64, st.integers(2, 400), elements=st.floats(-1e3, 1e3, allow_nan=False) | st.just(float("nan")))


@given(values, st.integers(2, 50))
def test_min_max_keeps_every_extreme_in_increasing_time(x, points):
    t = np.cumsum(0.01 + np.abs(np.sin(np.arange(x.size))))
    thin = min_max(Curve(t, {"x": x}), points)
    assert thin.t.size <= max(points, 2) or thin.t.size == x.size
    assert np.all(np.diff(thin.t) > 0.0)
    assert set(thin.t) <= set(t)
    kept = thin.columns["x"]
    assert np.fmin.reduce(kept) == np.fmin.reduce(x) or np.isnan(x).all()
    assert np.fmax.reduce(kept) == np.fmax.reduce(x) or np.isnan(x).all()


def test_gaps_and_breaks():
    t = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    assert gaps(t, at_least=2.0) == [(0.2, 5.0)]
    assert gaps(t, at_least=6.0) == []
    assert gaps(t[:1], at_least=2.0) == []
    broken = broken_at(Curve(t, {"x": t}), gaps(t, at_least=2.0))
    np.testing.assert_array_equal(broken.t, [0.0, 0.1, 0.2, 2.6, 5.0, 5.1])
    assert np.flatnonzero(np.isnan(broken.columns["x"])).tolist() == [3]


@given(
    st.integers(2, 400).flatmap(
        lambda n: st.tuples(
            arrays(np.float64, n, elements=st.floats(0.001, 1.0)), arrays(np.float64, n, elements=st.floats(-1e3, 1e3))
        )
    )
)
def test_thinned_batches_keep_every_extreme(columns):
    t, values = np.cumsum(columns[0]), columns[1]
    thinned = thin(Curve(t, {"fx": values}))
    assert np.all(np.diff(thinned.t) > 0.0)
    assert set(thinned.columns["fx"]) <= set(values)
    for second in np.unique(np.floor(t / BUCKET_S)):
        inside = np.floor(t / BUCKET_S) == second
        kept = thinned.columns["fx"][np.floor(thinned.t / BUCKET_S) == second]
        assert kept.min() == values[inside].min()
        assert kept.max() == values[inside].max()


def test_a_coarse_window_shows_what_the_samples_show(box, admin):
    """Sixty seconds in sixty points are drawn from thinned batches, in both frames, the second time from memory."""
    for frame in ("a", "v"):
        fine_header, fine = decode(admin.get(f"/api/v1/devices/{box[0]}/signals?frame={frame}&points=20000").content)
        for _ in range(2):
            header, coarse = decode(admin.get(f"/api/v1/devices/{box[0]}/signals?frame={frame}&points=60").content)
            assert np.allclose(header["gaps"], fine_header["gaps"], atol=BUCKET_S)
            for name in ("fx", "fy", "fz", "speed"):
                assert np.nanmax(coarse[name][1]) == np.nanmax(fine[name][1])
                assert np.nanmin(coarse[name][1]) == np.nanmin(fine[name][1])
            assert coarse["fx"][0].size <= 60 + 3


def test_memory_forgets_what_was_used_longest_ago():
    memory = Memory(max_bytes=3000)
    made = []

    def part(name: str) -> Curve:
        return memory.get(name, lambda: made.append(name) or Curve(np.arange(50.0), {"fx": np.zeros(50)}))

    for name in ("a", "b", "a", "c", "a", "b"):
        assert part(name).columns["fx"].dtype == np.float32
    assert made == ["a", "b", "c", "b"]
