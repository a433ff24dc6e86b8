"""An event for other programs: the element table of 49 CFR 563, and the raw trace of its window."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from mcap.writer import CompressionType, Writer

from server.errors import NotFoundError
from server.events.window import Part, between, merged
from server.formats.columns import Columns
from server.formats.tables import write_csv
from server.models import Batch
from server.store import BlobStore, raw_columns

TraceFormat = Literal["parquet", "csv", "mcap"]
TRACE_MEDIA = {
    "parquet": "application/vnd.apache.parquet",
    "csv": "text/csv; charset=utf-8",
    "mcap": "application/octet-stream",
}
NOT_RECORDED = "not recorded"

_TOPICS = {
    "/box/inertial": ("fx", "fy", "fz", "wx", "wy", "wz", "mx", "my", "mz", "temp"),
    "/box/gnss": ("lat", "lon", "alt", "speed", "course", "fix", "hdop", "sats", "utc"),
    "/box/power": ("battery", "ignition"),
}


def edr_json(document: dict[str, Any], event_sha256: str) -> dict[str, Any]:
    """Tables I and II of 49 CFR 563.7 as far as a box can fill them."""
    return {
        "standard": "shaped after 49 CFR 563.7, tables I and II; not the output of the vehicle's own recorder",
        "event_sha256": event_sha256,
        "algorithm": document["algorithm"],
        "software": document["software"],
        "device_id": document["subject"]["device_id"],
        "t0_s": document["event"]["t0_s"],
        "utc_t0": utc_t0(document),
        "elements": [
            {**element, "values": element["values"] if element["recorded"] else NOT_RECORDED}
            for element in document["edr"]
        ],
    }


def edr_csv(document: dict[str, Any]) -> bytes:
    """The same as text, one row for each value."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", "element", "unit", "time_s", "value", "low95", "high95", "note"])
    for element in document["edr"]:
        head = [element["table"], element["name"], element["unit"]]
        low, high = element["interval95"] or ("", "")
        times = element["times_s"] or [""] * len(element["values"])
        for time, value in zip(times, element["values"], strict=True):
            writer.writerow([*head, time, value, low, high, element["note"]])
        if not element["recorded"]:
            writer.writerow([*head, "", NOT_RECORDED, "", "", element["note"]])
    return text.getvalue().encode()


def utc_t0(document: dict[str, Any]) -> float:
    """Unix time of time zero: by the fixes around it, else by the boot's clock."""
    by_fixes = document["event"]["basis"]["utc_t0"]
    clock = document["inputs"]["clock"]
    t0 = document["event"]["t0_s"]
    return by_fixes if by_fixes is not None else clock["utc_offset_s"] + (1.0 + clock["utc_drift"]) * t0


def utc_sigma_s(document: dict[str, Any]) -> float:
    """1 sigma of `utc_t0`, s."""
    by_fixes: float | None = document["event"]["basis"]["utc_sigma_s"]
    return document["inputs"]["clock"]["utc_sigma_s"] if by_fixes is None else by_fixes


def used(document: dict[str, Any], batches: Sequence[Batch]) -> list[Batch]:
    """Those of an event's batches that this revision rests on."""
    named = {batch["chain_index"] for batch in document["inputs"]["batches"]}
    return [batch for batch in batches if batch.chain_index in named]


def trace(store: BlobStore, document: dict[str, Any], batches: Sequence[Batch]) -> Columns:
    """Raw samples of the event's window as the box sent them, in its own axes and on its own clock."""
    parts: list[Part] = []
    for batch in used(document, batches):
        try:
            parts.append(Part(raw_columns(store, batch), batch.stream == "burst"))
        except KeyError:
            raise NotFoundError(f"The raw data of batch {batch.chain_index} are erased", code="erased") from None
    first, last = document["event"]["basis"]["window_s"]
    return between(merged(parts), first, last)


def trace_bytes(columns: Columns, document: dict[str, Any], form: TraceFormat) -> bytes:
    """The trace in a format."""
    if form == "parquet":
        return columns.to_parquet()
    return write_csv(columns) if form == "csv" else _mcap(columns, document)


def _mcap(columns: Columns, document: dict[str, Any]) -> bytes:
    sink = io.BytesIO()
    writer = Writer(sink, compression=CompressionType.ZSTD)
    writer.start(profile="", library="scatola")
    t = columns.values["t"]
    offset = utc_t0(document) - document["event"]["t0_s"]
    nanoseconds = np.round((t + offset) * 1e9).astype(np.int64).tolist()
    for topic, wanted in _TOPICS.items():
        names = [name for name in wanted if name in columns.values]
        if not names:
            continue
        values = np.stack([columns.values[name] for name in names])
        channel = _channel(writer, topic, names)
        for sequence, row in enumerate(np.flatnonzero(~np.isnan(values).all(axis=0)).tolist()):
            told = {n: v for n, v in zip(names, values[:, row].tolist(), strict=True) if v == v}  # noqa: PLR0124  NaN
            data = json.dumps({"t": float(t[row]), **told}).encode()
            at = nanoseconds[row]
            writer.add_message(channel, log_time=at, publish_time=at, sequence=sequence, data=data)
    writer.finish()
    return sink.getvalue()


def _channel(writer: Writer, topic: str, names: Sequence[str]) -> int:
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in ("t", *names)}, "required": ["t"]}
    title = f"scatola.{topic.rsplit('/', 1)[1]}"
    number = writer.register_schema(title, encoding="jsonschema", data=json.dumps(schema).encode())
    return writer.register_channel(topic, message_encoding="json", schema_id=number)
