"""Tracks, events and samples of many vehicles as one Parquet file, written while it is read.

Rows are read a page at a time, each page in a short view of its own, and leave as row groups: memory is that of one
group, however much is taken out.  A file that was cut short has no footer, and no reader takes it for a whole one.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from sqlalchemy import select, tuple_

from server.database import Database
from server.errors import ProblemError
from server.formats.columns import NAMES
from server.models import Batch, Boot, Device, Event, TrackPoint, Trip
from server.store import BlobStore, raw_columns

Kind = Literal["tracks", "events", "samples"]
KINDS: tuple[Kind, ...] = get_args(Kind)

Table: TypeAlias = Any
Schema: TypeAlias = Any
"""Of pyarrow, which ships no types."""

GROUP_ROWS = 100_000
_PAGE = 500

_TIME = pa.timestamp("us", tz="UTC")
TRACKS = pa.schema(
    [
        *((name, pa.string()) for name in ("trip_id", "device_id", "vehicle_id")),
        ("at", _TIME),
        *((name, pa.float64()) for name in ("t_s", "lat_deg", "lon_deg", "alt_m", "speed_mps", "course_rad")),
    ]
)
_EVENT_FIGURES = ("pdof_deg", "impact_speed_kmh", "peak_g", "asi", "olc_g")
_DELTA_V = ("longitudinal", "lateral", "resultant")
EVENTS = pa.schema(
    [
        *((name, pa.string()) for name in ("event_id", "device_id", "vehicle_id", "boot", "kind")),
        ("severe", pa.bool_()),
        ("at", _TIME),
        ("t0_s", pa.float64()),
        ("t_end_s", pa.float64()),
        ("revision", pa.int32()),
        ("verdict", pa.string()),
        *((f"delta_v_{name}_kmh", pa.float64()) for name in _DELTA_V),
        *((name, pa.float64()) for name in _EVENT_FIGURES),
        ("clipped", pa.bool_()),
        ("result", pa.string()),
    ]
)
SAMPLES = pa.schema(
    [
        *((name, pa.dictionary(pa.int32(), pa.string())) for name in ("device_id", "batch_id", "stream", "boot")),
        ("unix_s", pa.float64()),
        *((name, pa.float64()) for name in NAMES),
    ]
)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to take out: of one box or all, from a moment on, up to another and without it."""

    kind: Kind
    device_id: str | None = None
    since: dt.datetime | None = None
    until: dt.datetime | None = None

    def told(self) -> dict[str, Any]:
        """For the audit log."""
        moments = {"from": self.since, "to": self.until}
        said = {name: moment.isoformat() for name, moment in moments.items() if moment is not None}
        return said | ({} if self.device_id is None else {"device": self.device_id})


def export(database: Database, store: BlobStore, wanted: Wanted) -> Iterator[bytes]:
    """The file's bytes, in pieces."""
    notes: dict[str, str] = {"kind": wanted.kind}
    if wanted.kind == "tracks":
        return _parquet(TRACKS, _tracks(database, wanted), notes)
    if wanted.kind == "events":
        return _parquet(EVENTS, _events(database, wanted), notes)
    return _parquet(SAMPLES, _samples(database, store, wanted, notes), notes)


class _Sink:
    """What the writer wrote since it was last taken."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self.closed = False

    def write(self, data: bytes) -> int:
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None: ...

    def close(self) -> None:
        self.closed = True

    def take(self) -> bytes:
        data = b"".join(self._parts)
        self._parts.clear()
        return data


def _parquet(schema: Schema, tables: Iterator[Table], notes: dict[str, str]) -> Iterator[bytes]:
    sink = _Sink()
    with pq.ParquetWriter(pa.PythonFile(sink, mode="w"), schema, compression="zstd") as writer:
        waiting: list[Table] = []
        for table in tables:
            waiting.append(table)
            if sum(each.num_rows for each in waiting) >= GROUP_ROWS:
                writer.write_table(pa.concat_tables(waiting).unify_dictionaries(), row_group_size=GROUP_ROWS)
                waiting.clear()
                yield sink.take()
        if waiting:
            writer.write_table(pa.concat_tables(waiting).unify_dictionaries(), row_group_size=GROUP_ROWS)
        writer.add_key_value_metadata(notes)
    yield sink.take()


def _rows(schema: Schema, rows: list[dict[str, Any]]) -> Table:
    return pa.Table.from_pylist(rows, schema=schema)


def _pages(database: Database, query: Any, moment: Any, row_id: Any) -> Iterator[list[Any]]:
    """Pages of a query of rows in the order of a moment and an id."""
    query = query.order_by(moment, row_id).limit(_PAGE)
    page_query = query
    while True:
        with database.reading() as session:
            page = list(session.scalars(page_query))
        if not page:
            return
        yield page
        place = getattr(page[-1], moment.key), page[-1].id
        page_query = query.where(tuple_(moment, row_id) > place)


def _within(query: Any, wanted: Wanted, device: Any, moment: Any) -> Any:
    if wanted.device_id is not None:
        query = query.where(device == wanted.device_id)
    if wanted.since is not None:
        query = query.where(moment >= wanted.since)
    return query if wanted.until is None else query.where(moment < wanted.until)


def _tracks(database: Database, wanted: Wanted) -> Iterator[Table]:
    query = _within(select(Trip), wanted, Trip.device_id, Trip.began_at)
    for page in _pages(database, query, Trip.began_at, Trip.id):
        for trip in page:
            points = select(TrackPoint).where(TrackPoint.trip_id == trip.id).order_by(TrackPoint.t_s)
            with database.reading() as session:
                rows = [
                    {
                        "trip_id": trip.id,
                        "device_id": trip.device_id,
                        "vehicle_id": trip.vehicle_id,
                        **{name: getattr(point, name) for name in TRACKS.names[3:]},
                    }
                    for point in session.scalars(points)
                ]
            if rows:
                yield _rows(TRACKS, rows)


def _events(database: Database, wanted: Wanted) -> Iterator[Table]:
    query = _within(select(Event).where(Event.withdrawn_at.is_(None)), wanted, Event.device_id, Event.at)
    for page in _pages(database, query, Event.at, Event.id):
        yield _rows(EVENTS, [_event(event) for event in page])


def _event(event: Event) -> dict[str, Any]:
    own = ("device_id", "vehicle_id", "boot", "kind", "severe", "at", "t0_s", "t_end_s", "revision", "verdict")
    result, delta_v = event.result, event.result.get("delta_v_kmh") or {}
    return {
        "event_id": event.id,
        **{name: getattr(event, name) for name in own},
        **{f"delta_v_{name}_kmh": delta_v.get(name) for name in _DELTA_V},
        **{name: result.get(name) for name in _EVENT_FIGURES},
        "clipped": result.get("clipped"),
        "result": orjson.dumps(result).decode(),
    }


def _samples(database: Database, store: BlobStore, wanted: Wanted, notes: dict[str, str]) -> Iterator[Table]:
    skipped = 0
    with database.reading() as session:
        query = select(Device.id).order_by(Device.id)
        devices = session.scalars(query if wanted.device_id is None else query.where(Device.id == wanted.device_id))
        ids = list(devices)
    for device_id in ids:
        with database.reading() as session:
            boots = {boot.boot: boot for boot in session.scalars(select(Boot).where(Boot.device_id == device_id))}
        query = _within(select(Batch).where(Batch.device_id == device_id), wanted, Batch.device_id, Batch.received_at)
        for page in _pages(database, query, Batch.received_at, Batch.id):
            for batch in page:
                table = _batch(store, batch, boots.get(batch.boot))
                skipped += table is None
                if table is not None:
                    yield table
    # Read with the file, so that nobody takes what is missing for what never was.
    notes["batches_without_data"] = str(skipped)


def _batch(store: BlobStore, batch: Batch, boot: Boot | None) -> Table | None:
    """A batch's rows; None when its raw data are gone or damaged."""
    try:
        columns = raw_columns(store, batch)
    except (KeyError, ProblemError):
        return None
    rows = columns.rows
    t = columns.values["t"]
    unix_s = pa.nulls(rows, pa.float64()) if boot is None else pa.array(boot.utc_offset_s + (1.0 + boot.utc_drift) * t)
    values = [
        pa.array(columns.values[name], from_pandas=True) if name in columns.values else pa.nulls(rows, pa.float64())
        for name in NAMES
    ]
    words = [_same(word, rows) for word in (batch.device_id, batch.id, batch.stream, batch.boot)]
    return pa.Table.from_arrays([*words, unix_s, *values], schema=SAMPLES)


def _same(word: str, rows: int) -> Any:
    """A column of one word."""
    return pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), pa.array([word]))
