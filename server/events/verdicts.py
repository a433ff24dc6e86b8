"""What people said of events, beside the figures by which they were found: to tune detection on."""

from __future__ import annotations

import csv
import datetime as dt
import io
from collections.abc import Iterable, Iterator
from typing import Any, Literal

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.events.queries import LISTED
from server.formats.spreadsheet import spreadsheet_text
from server.models import Event, EventRevision, Vehicle

VerdictFormat = Literal["csv", "json"]


def verdicts(
    session: Session, organisation_id: str, *, since: dt.datetime | None = None, until: dt.datetime | None = None
) -> Iterator[dict[str, Any]]:
    """A flat row for each event that somebody judged, the oldest first; it holds no place."""
    query = (
        select(Event, EventRevision.algorithm, EventRevision.input_sha256, Vehicle.vehicle_class)
        .join(EventRevision, (EventRevision.event_id == Event.id) & (EventRevision.number == Event.revision))
        .outerjoin(Vehicle, Vehicle.id == Event.vehicle_id)
        .where(Event.organisation_id == organisation_id, Event.verdict.is_not(None), *LISTED)
    )
    if since is not None:
        query = query.where(Event.at >= since)
    if until is not None:
        query = query.where(Event.at < until)
    for event, algorithm, inputs, vehicle_class in session.execute(query.order_by(Event.at, Event.id)):
        yield _row(event, algorithm, inputs, vehicle_class)


def _row(event: Event, algorithm: str, input_sha256: str, vehicle_class: str | None) -> dict[str, Any]:
    told = event.result
    basis: dict[str, Any] = told.get("basis") or {}
    pulse: dict[str, Any] = told.get("pulse") or {}
    row: dict[str, Any] = {
        "event_id": event.id,
        "verdict": event.verdict,
        "note": event.note,
        "reviewed_at": event.reviewed_at,
        "kind": event.kind,
        "severe": event.severe,
        "confidence": told.get("confidence"),
        "at": event.at,
        "device_id": event.device_id,
        "vehicle_class": vehicle_class,
        "boot": event.boot,
        "t0_s": event.t0_s,
        "t_end_s": event.t_end_s,
        "revision": event.revision,
        "algorithm": algorithm,
        "input_sha256": input_sha256,
    }
    for name in ("longitudinal", "lateral", "resultant"):
        row |= _estimate(f"delta_v_{name}_kmh", told["delta_v_kmh"][name], told["delta_v_interval95_kmh"][name])
    row |= _estimate("pdof_deg", told["pdof_deg"], told["pdof_interval95_deg"])
    row |= _estimate("impact_speed_kmh", told["impact_speed_kmh"], told["impact_speed_interval95_kmh"])
    row |= {name: told.get(name) for name in ("time_of_max_ms", "peak_g", "clipped_samples", "asi", "olc_g")}
    row |= {name: pulse.get(name) for name in ("mean_g", "duration_ms", "filter")}
    row |= {name: basis.get(name) for name in ("sample_rate_hz", "full_scale_g", "mounting_status", "gyro")}
    row |= {name: basis.get(name) for name in ("fixes_before", "fixes_after")}
    return {**row, "quality": list(told["quality"])}


def _estimate(name: str, value: float | None, interval: list[float] | None) -> dict[str, float | None]:
    low, high = interval or (None, None)
    return {name: value, f"{name}_low95": low, f"{name}_high95": high}


def as_csv(rows: Iterable[dict[str, Any]]) -> bytes:
    """The same as text: a header, a line for each event, remarks parted by blanks."""
    sink = io.StringIO()
    writer: Any = None  # csv's writer has no public type
    for row in rows:
        if writer is None:
            writer = csv.writer(sink, lineterminator="\r\n")
            writer.writerow(row)
        writer.writerow([_cell(value) for value in row.values()])
    return sink.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, dt.datetime):
        return value.isoformat()
    if isinstance(value, list):
        return " ".join(value)
    return spreadsheet_text(value) if isinstance(value, str) else value
