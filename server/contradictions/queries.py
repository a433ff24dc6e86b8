"""What stands against an event, or beside it: found in the rows of the box around it when somebody asks.

Nothing here is part of the event's document: data that come later change what is known about the hours around an
event, and the document must stay what was computed from its inputs.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from server.contradictions.schemas import ClaimOut, ContradictionOut, Weight
from server.errors import NotFoundError
from server.ingest.chain import link
from server.models import AccidentClaim, Batch, BatchDigest, Boot, Device, Event, Installation, SequenceRun, Trip

CHECKED = (
    "box_moved_before",
    "box_not_fixed",
    "silent_before",
    "silent_after",
    "gap_around",
    "batches_missing",
    "unreadable_data",
    "chain_broken",
    "clock_jump",
    "clock_unsure",
    "gps_disagrees",
    "distance_disagrees",
    "claim_disagrees",
)
MOVED_BEFORE = dt.timedelta(days=7)
MOVED_SHORTLY = dt.timedelta(hours=24)
AROUND_S = 600.0
GAP_S = 5.0
SILENT_S = 60.0
CLOCK_JUMP_S = 2.0
CHAIN_LINKS = 500
"""Links on either side of the event's own that are computed again; `scatola verify` does the whole chain."""
DISTANCES = 0.15, 1000.0
"""Share by which a trip's two distances may differ, and from which length, m."""


def contradictions(session: Session, event: Event) -> list[ContradictionOut]:
    """Everything of `CHECKED` that is so, the gravest first."""
    boot = session.get(Boot, (event.device_id, event.boot))
    found = [
        *_box(session, event),
        *_data(session, event, boot),
        *_chain(session, event),
        *_clock(session, event, boot),
        *_gps(session, event),
        *_claims(session, event),
    ]
    order = {"grave": 0, "doubt": 1, "note": 2}
    return sorted(found, key=lambda each: (order[each.weight], each.code))


def claims(session: Session, organisation_id: str, *, vehicle_id: str | None, limit: int) -> Sequence[AccidentClaim]:
    """Claims, the newest first."""
    wanted = select(AccidentClaim).where(AccidentClaim.organisation_id == organisation_id)
    if vehicle_id is not None:
        wanted = wanted.where(AccidentClaim.vehicle_id == vehicle_id)
    return session.scalars(wanted.order_by(AccidentClaim.created_at.desc(), AccidentClaim.id).limit(limit)).all()


def claim_of(session: Session, organisation_id: str, claim_id: str) -> AccidentClaim:
    """A claim of the organisation."""
    row = session.get(AccidentClaim, claim_id)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no claim {claim_id!r}")
    return row


def claim_out(row: AccidentClaim) -> ClaimOut:
    """A claim as JSON."""
    own = ("id", "vehicle_id", "reference", "direction_deg", "note", "created_at", "created_by", "answer")
    told = {name: getattr(row, name) for name in own}
    return ClaimOut.model_validate({**told, "from": row.began_at, "to": row.ended_at})


def _told(code: str, weight: Weight, detail: str, **evidence: Any) -> ContradictionOut:
    return ContradictionOut(code=code, weight=weight, detail=detail, evidence=evidence)


def _box(session: Session, event: Event) -> Iterator[ContradictionOut]:
    """The box turned in its vehicle before the event, or lying loose in it."""
    moved = session.scalars(
        select(Installation)
        .where(Installation.device_id == event.device_id, Installation.beginning.in_(("moved", "swapped", "manual")))
        .where(Installation.began_at > event.at - MOVED_BEFORE, Installation.began_at <= event.at)
        .order_by(Installation.began_at.desc())
    )
    for row in moved:
        ago = event.at - row.began_at
        words = {
            "moved": "was turned",
            "swapped": "was put into this vehicle",
            "manual": "had its mounting set by hand",
        }
        yield _told(
            "box_moved_before",
            "doubt" if ago < MOVED_SHORTLY else "note",
            f"The box {words[row.beginning]} {_span(ago)} before the event",
            began_at=row.began_at.isoformat(),
            beginning=row.beginning,
            angle_rad=row.moved_angle_rad,
        )
    there = session.scalars(
        select(Installation)
        .where(Installation.device_id == event.device_id, Installation.began_at <= event.at)
        .order_by(Installation.began_at.desc())
        .limit(1)
    ).first()
    if there is not None and there.status == "not_fixed":
        yield _told("box_not_fixed", "doubt", "The box was loose in the vehicle", installation_id=there.id)


def _data(session: Session, event: Event, boot: Boot | None) -> Iterator[ContradictionOut]:
    """Silence, gaps and damage in the ten minutes on either side."""
    first, last = event.t0_s - AROUND_S, event.t_end_s + AROUND_S
    of_boot = select(Batch).where(Batch.device_id == event.device_id, Batch.boot == event.boot)
    batches = session.scalars(
        of_boot.where(Batch.t_last_s >= first, Batch.t_first_s <= last).order_by(Batch.t_first_s)
    ).all()
    yield from _gaps(event, batches)
    broken = [batch for batch in batches if batch.failure is not None]
    if broken:
        yield _told(
            "unreadable_data",
            "grave",
            f"{len(broken)} uploads around the event cannot be read",
            batches=[batch.id for batch in broken],
            failures=[batch.failure for batch in broken],
        )
    if boot is None:
        return
    begins, ends = event.t0_s - boot.t_first_s, boot.t_last_s - event.t_end_s
    if begins < SILENT_S:
        yield _told(
            "silent_before",
            "doubt",
            f"The box was switched on, or its memory begins, {begins:.0f} s before the event",
            seconds=begins,
        )
    if ends < SILENT_S and _has_later_boot(session, event, boot):
        yield _told(
            "silent_after",
            "note",
            f"The box was switched off, or lost its supply, {ends:.0f} s after the event",
            seconds=ends,
        )
    yield from _missing(session, event, batches)


def _has_later_boot(session: Session, event: Event, boot: Boot) -> bool:
    """Whether it went on after a new start: else more may simply still come."""
    later = select(Boot.boot).where(Boot.device_id == event.device_id, Boot.ordinal > boot.ordinal).limit(1)
    return session.scalar(later) is not None


def _gaps(event: Event, batches: Sequence[Batch]) -> Iterator[ContradictionOut]:
    """Times around the event of which no stream has data."""
    reach = float("-inf")
    for batch in batches:
        if reach > float("-inf") and batch.t_first_s - reach > GAP_S:
            begin, end = reach - event.t0_s, batch.t_first_s - event.t0_s
            near = begin < event.t_end_s - event.t0_s + SILENT_S and end > -SILENT_S
            yield _told(
                "gap_around",
                "doubt" if near else "note",
                f"No data from {begin:+.0f} to {end:+.0f} s of the event",
                from_s=begin,
                to_s=end,
            )
        reach = max(reach, batch.t_last_s)


def _missing(session: Session, event: Event, batches: Sequence[Batch]) -> Iterator[ContradictionOut]:
    """Numbers of uploads between those around the event that never came."""
    for stream in ("continuous", "burst"):
        numbers = [batch.sequence for batch in batches if batch.stream == stream]
        if not numbers:
            continue
        runs = session.scalars(
            select(SequenceRun)
            .where(
                SequenceRun.device_id == event.device_id,
                SequenceRun.stream == stream,
                SequenceRun.boot == event.boot,
                SequenceRun.last >= min(numbers),
                SequenceRun.first <= max(numbers),
            )
            .order_by(SequenceRun.first)
        ).all()
        missing = [(before.last + 1, after.first - 1) for before, after in pairwise(runs)]
        if missing:
            count = sum(last - first + 1 for first, last in missing)
            yield _told(
                "batches_missing",
                "doubt",
                f"{count} uploads of the {stream} stream around the event never came",
                stream=stream,
                ranges=missing[:100],
            )


def _chain(session: Session, event: Event) -> Iterator[ContradictionOut]:
    """Links of the chain of evidence around the event, computed again."""
    own = session.scalars(
        select(Batch.chain_index)
        .where(Batch.device_id == event.device_id, Batch.boot == event.boot)
        .where(Batch.t_last_s >= event.t0_s - AROUND_S, Batch.t_first_s <= event.t_end_s + AROUND_S)
    ).all()
    if not own:
        return
    first, last = max(0, min(own) - CHAIN_LINKS), max(own) + CHAIN_LINKS
    rows = session.scalars(
        select(Batch)
        .where(Batch.device_id == event.device_id, Batch.chain_index >= first - 1, Batch.chain_index <= last)
        .order_by(Batch.chain_index)
    ).all()
    device = session.get_one(Device, event.device_id)
    befores = [None, *rows[:-1]]
    bad = [
        row.chain_index
        for before, row in zip(befores, rows, strict=True)
        if row.chain_index >= first and not _links(before, row, device)
    ]
    if bad:
        yield _told(
            "chain_broken",
            "grave",
            f"The chain of evidence does not hold at {len(bad)} links around the event",
            links=bad[:100],
        )


def _links(before: Batch | None, row: Batch, device: Device) -> bool:
    """Whether a row is what its link says and follows the one before."""
    if row.chain_index == 0:
        previous = device.id
    elif before is None or before.chain_index != row.chain_index - 1:
        return False
    else:
        previous = before.chain_sha256
    wanted = link(
        previous,
        body_sha256=row.body_sha256,
        column_sha256=row.column_sha256,
        stream=row.stream,
        boot=row.boot,
        sequence=row.sequence,
        received_at=row.received_at,
    )
    return wanted == row.chain_sha256


def _clock(session: Session, event: Event, boot: Boot | None) -> Iterator[ContradictionOut]:
    """The box's clock against UTC."""
    if boot is None:
        return
    if boot.utc_source != "gnss":
        yield _told(
            "clock_unsure",
            "note",
            f"No fix told UTC: the time of the event is good to {boot.utc_sigma_s:.0f} s",
            sigma_s=boot.utc_sigma_s,
        )
    found = session.execute(
        select(BatchDigest.clock_t_s, BatchDigest.clock_offset_s)
        .join(Batch, Batch.id == BatchDigest.batch_id)
        .where(Batch.device_id == event.device_id, Batch.boot == event.boot, BatchDigest.clock_t_s.is_not(None))
        .where(Batch.t_last_s >= event.t0_s - 3600.0, Batch.t_first_s <= event.t_end_s + 3600.0)
        .order_by(BatchDigest.clock_t_s)
    ).all()
    pairs = [(t, offset) for t, offset in found if t is not None and offset is not None]
    for (_, before), (t, after) in pairwise(pairs):
        jump_s, at_s = after - before, t - event.t0_s
        if abs(jump_s) > CLOCK_JUMP_S:
            yield _told(
                "clock_jump",
                "doubt",
                f"The box's clock jumped by {jump_s:+.1f} s against UTC, {at_s:+.0f} s from the event",
                jump_s=jump_s,
                at_s=at_s,
            )
    yield from _overlap(session, event, boot)


def _overlap(session: Session, event: Event, boot: Boot) -> Iterator[ContradictionOut]:
    """Another run of the clock that claims the same time: one box has one."""
    at = event.at.timestamp()
    for other in session.scalars(select(Boot).where(Boot.device_id == event.device_id, Boot.boot != boot.boot)):
        margin = 3.0 * (other.utc_sigma_s + boot.utc_sigma_s)
        if other.unix_s(other.t_first_s) + margin < at < other.unix_s(other.t_last_s) - margin:
            yield _told(
                "clock_jump",
                "grave",
                f"Another run of the box's clock, {other.boot}, has data of the same moment",
                boot=other.boot,
            )


def _gps(session: Session, event: Event) -> Iterator[ContradictionOut]:
    """The receiver against the accelerometer, and against itself."""
    told: Mapping[str, Any] = event.result
    if "gps_disagrees" in told["quality"]:
        pulse = told["pulse"] or {}
        yield _told(
            "gps_disagrees",
            "doubt",
            "The velocity change that the fixes show is not the one that the accelerometer shows",
            accelerometer_kmh=pulse.get("measured_delta_v_kmh"),
            gps_kmh=pulse.get("gps_delta_v_kmh"),
        )
    trips = session.scalars(
        select(Trip).where(
            Trip.device_id == event.device_id,
            Trip.began_at <= event.at,
            Trip.ended_at >= event.at - dt.timedelta(hours=1),
        )
    )
    share, least = DISTANCES
    for trip in trips:
        longest = max(trip.distance_m, trip.position_distance_m)
        if longest > least and abs(trip.distance_m - trip.position_distance_m) > share * longest:
            yield _told(
                "distance_disagrees",
                "doubt",
                "On the trip of the event, the speeds and the positions of the receiver tell different distances: "
                f"{trip.distance_m / 1000.0:.1f} and {trip.position_distance_m / 1000.0:.1f} km",
                trip_id=trip.id,
            )


def _claims(session: Session, event: Event) -> Iterator[ContradictionOut]:
    """Claims about the vehicle whose direction is not the event's."""
    if event.vehicle_id is None:
        return
    claims = session.scalars(
        select(AccidentClaim).where(
            AccidentClaim.vehicle_id == event.vehicle_id,
            AccidentClaim.began_at <= event.at,
            AccidentClaim.ended_at >= event.at,
        )
    )
    for claim in claims:
        for pulse in claim.answer["pulses"]:
            if pulse["event_id"] == event.id and pulse["direction"] == "disagrees":
                yield _told(
                    "claim_disagrees",
                    "doubt",
                    f"Claim {claim.reference} says that the force came from {claim.direction_deg:.0f}°, "
                    f"the box from {pulse['pdof_deg']:.0f}°",
                    claim_id=claim.id,
                )


def _span(span: dt.timedelta) -> str:
    hours = span.total_seconds() / 3600.0
    if hours >= 48.0:
        return f"{hours / 24.0:.0f} days"
    return f"{hours:.0f} h" if hours >= 2.0 else f"{60.0 * hours:.0f} min"
