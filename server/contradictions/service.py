"""Somebody says that a vehicle had an accident: what the recorded data show of it.

A claim without a pulse is not a lie, and is not called one: the answer says what was looked at, and how
large a change of velocity could have stayed unseen.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from nav_core.typing import Floats
from server.contradictions.queries import contradictions
from server.contradictions.schemas import AnswerOut, BoundOut, ClaimIn, PulseOut
from server.events.queries import events
from server.formats.columns import Columns
from server.models import AccidentClaim, Assignment, Event, new_id
from server.models.event import CRASHES
from server.signals.queries import Piece, pieces
from server.store import BlobStore
from server.vehicles.queries import vehicle_of

PULSE_S = 0.3
"""Longer than the pulse of a crash between vehicles."""
MEAN_S = 5.0
GAP_S = 2.0
MIN_RATE_HZ = 50.0
BIAS_MPS2 = 0.5
"""What a turn of the vehicle against gravity or a drift of the sensor may do to the mean within seconds."""
DIRECTION_DEG = 30.0
MAX_GAPS = 100
AROUND = dt.timedelta(seconds=60)
"""A claim's clock is a person's."""
_G = 9.80665


@dataclass(frozen=True)
class Samples:
    """Specific force of a box in the window: UTC seconds, shape (n,), and m/s², shape (n, 3)."""

    unix_s: Floats
    force: Floats


def boxes_of(session: Session, organisation_id: str, wanted: ClaimIn) -> list[str]:
    """Boxes that sat in the vehicle during the window."""
    vehicle_of(session, organisation_id, wanted.vehicle_id)
    sat = select(Assignment.device_id).where(
        Assignment.vehicle_id == wanted.vehicle_id,
        Assignment.began_at <= wanted.until,
        or_(Assignment.ended_at.is_(None), Assignment.ended_at >= wanted.since),
    )
    return sorted(set(session.scalars(sat)))


def pieces_of(session: Session, boxes: Sequence[str], wanted: ClaimIn) -> list[list[Piece]]:
    """The batches of each box that reach into the window."""
    return [pieces(session, box, wanted.since, wanted.until) for box in boxes]


def read(store: BlobStore, parts: Sequence[Piece], wanted: ClaimIn) -> Samples:
    """The samples of a box within the window; a blob that is gone or damaged is a gap."""
    begin, end = wanted.since.timestamp(), wanted.until.timestamp()
    times: list[Floats] = [np.empty(0)]
    forces: list[Floats] = [np.empty((0, 3))]
    for part in parts:
        try:
            values = Columns.from_parquet(store.get(part.blob_key)).values
        except (KeyError, ValueError, OSError):
            continue
        if "fx" not in values:
            continue
        unix_s = part.utc_offset_s + (1.0 + part.utc_drift) * values["t"]
        force = np.column_stack([values[name] for name in ("fx", "fy", "fz")])
        keep = (unix_s >= begin) & (unix_s <= end) & np.isfinite(force).all(axis=1)
        times.append(unix_s[keep])
        forces.append(force[keep])
    unix_s, force = np.concatenate(times), np.concatenate(forces)
    order = np.argsort(unix_s, kind="stable")
    order = order[np.diff(unix_s[order], prepend=-np.inf) > 0.0]
    return Samples(unix_s[order], force[order])


def bound_of(samples: Samples) -> BoundOut | None:
    """The largest change of velocity within any `PULSE_S`, over runs of samples without a gap.

    In the box's own axes, against the mean of the `MEAN_S` around, which holds gravity whatever way up the box is.
    The resultant of three axes is at least that of the horizontal two, so this is an upper bound; to it is added
    what the mean may be wrong by.
    """
    best: tuple[float, float, float] | None = None
    steps = np.diff(samples.unix_s)
    if steps.size == 0:
        return None
    step = float(np.median(steps))
    for run in _runs(samples.unix_s):
        t, force = samples.unix_s[run], samples.force[run]
        if t.size < 2:
            continue
        mean, span_s = _running_mean(t, force, step)
        deviation = force - mean
        widths = np.diff(t, prepend=t[0] - min(step, GAP_S))
        velocity = np.vstack([np.zeros((1, 3)), np.cumsum(deviation * widths[:, None], axis=0)])
        ends = np.searchsorted(t, t + PULSE_S, side="right")
        # A pulse takes part in the mean that is taken off it.
        part = np.minimum(PULSE_S / span_s, 0.9)
        change = np.linalg.norm(velocity[ends] - velocity[: t.size], axis=1) / (1.0 - part)
        at = int(np.argmax(change))
        found = float(change[at]), float(t[at]), float(np.linalg.norm(deviation, axis=1).max())
        best = found if best is None else (*max(best[:2], found[:2]), max(best[2], found[2]))
    if best is None:
        return None
    return BoundOut(
        max_delta_v_kmh=3.6 * (best[0] + BIAS_MPS2 * PULSE_S),
        at=dt.datetime.fromtimestamp(best[1], dt.UTC),
        window_s=PULSE_S,
        peak_g=best[2] / _G,
        sample_rate_hz=1.0 / step,
        reliable=1.0 / step >= MIN_RATE_HZ,
    )


def _runs(unix_s: Floats) -> Iterator[slice]:
    edges = [0, *(np.flatnonzero(np.diff(unix_s) > GAP_S) + 1).tolist(), unix_s.size]
    return (slice(first, last) for first, last in pairwise(edges) if last > first)


def _running_mean(t: Floats, force: Floats, step: float) -> tuple[Floats, Floats]:
    """Mean over `MEAN_S` around each sample, shape (n, 3), and how long that is at the ends, shape (n,)."""
    total = np.vstack([np.zeros((1, 3)), np.cumsum(force, axis=0)])
    first = np.searchsorted(t, t - 0.5 * MEAN_S, side="left")
    last = np.searchsorted(t, t + 0.5 * MEAN_S, side="right")
    return (total[last] - total[first]) / (last - first)[:, None], t[last - 1] - t[first] + step


def gaps_of(samples: Sequence[Samples], wanted: ClaimIn) -> list[tuple[float, float]]:
    """Spans of the window, UTC seconds, of which no box has samples."""
    begin, end = wanted.since.timestamp(), wanted.until.timestamp()
    t = np.sort(np.concatenate([np.array([begin, end]), *(each.unix_s for each in samples)]))
    wide = np.flatnonzero(np.diff(t) > GAP_S)
    return list(zip(t[wide].tolist(), t[wide + 1].tolist(), strict=True))


def register(
    session: Session,
    organisation_id: str,
    wanted: ClaimIn,
    boxes: Sequence[str],
    samples: Sequence[Samples],
    *,
    actor: str,
    now: dt.datetime,
) -> AccidentClaim:
    """Answer a claim and keep the answer."""
    found = events(
        session,
        organisation_id,
        vehicle_id=wanted.vehicle_id,
        kinds=CRASHES,
        since=wanted.since - AROUND,
        until=wanted.until + AROUND,
        limit=50,
    )
    answer = _answer(session, wanted, found, boxes, samples)
    row = AccidentClaim(
        id=new_id(),
        organisation_id=organisation_id,
        vehicle_id=wanted.vehicle_id,
        reference=wanted.reference,
        began_at=wanted.since,
        ended_at=wanted.until,
        direction_deg=wanted.direction_deg,
        note=wanted.note,
        created_at=now,
        created_by=actor[:254],
        answer=answer.model_dump(mode="json"),
    )
    session.add(row)
    return row


def _answer(
    session: Session, wanted: ClaimIn, found: Sequence[Event], boxes: Sequence[str], samples: Sequence[Samples]
) -> AnswerOut:
    gaps = gaps_of(samples, wanted)
    missing = sum(end - begin for begin, end in gaps)
    covered = max(0.0, 1.0 - missing / (wanted.until - wanted.since).total_seconds())
    bounds = [bound for each in samples if (bound := bound_of(each)) is not None]
    bound = max(bounds, key=lambda each: each.max_delta_v_kmh, default=None)
    pulses = [_pulse(event, wanted.direction_deg) for event in found]
    verdict = "pulse_found" if pulses else "no_data" if bound is None else "not_covered" if gaps else "no_pulse"
    return AnswerOut(
        verdict=verdict,
        says=_says(verdict, pulses, bound, covered),
        pulses=pulses,
        bound=bound,
        covered_share=covered,
        gaps=[(dt.datetime.fromtimestamp(a, dt.UTC), dt.datetime.fromtimestamp(b, dt.UTC)) for a, b in gaps[:MAX_GAPS]],
        boxes=list(boxes),
        contradictions=[each for event in found for each in contradictions(session, event)],
    )


def _pulse(event: Event, claimed_deg: float | None) -> PulseOut:
    told = event.result
    interval: list[float] | None = told["pdof_interval95_deg"]
    direction = "not_known"
    if claimed_deg is not None and interval is not None:
        direction = "agrees" if _within(claimed_deg, interval) else "disagrees"
    return PulseOut.model_validate(
        {
            "event_id": event.id,
            "kind": event.kind,
            "at": event.at,
            "delta_v_kmh": told["delta_v_kmh"]["resultant"],
            "delta_v_interval95_kmh": told["delta_v_interval95_kmh"]["resultant"],
            "pdof_deg": told["pdof_deg"],
            "pdof_interval95_deg": interval,
            "direction": direction,
        }
    )


def _within(angle_deg: float, interval_deg: Sequence[float]) -> bool:
    """Whether an angle is in an interval widened by `DIRECTION_DEG`; its ends may pass half a turn."""
    middle, half = 0.5 * (interval_deg[0] + interval_deg[1]), 0.5 * (interval_deg[1] - interval_deg[0])
    return abs((angle_deg - middle + 180.0) % 360.0 - 180.0) <= half + DIRECTION_DEG


def _says(verdict: str, pulses: Sequence[PulseOut], bound: BoundOut | None, covered: float) -> str:
    if verdict == "pulse_found":
        disagree = any(pulse.direction == "disagrees" for pulse in pulses)
        tail = "; its direction is not the claimed one" if disagree else ""
        return f"The box recorded {len(pulses)} impact{'s' if len(pulses) > 1 else ''} in the window{tail}."
    if bound is None:
        return "No box of the vehicle recorded anything in the window."
    limit = f"no change of velocity above {bound.max_delta_v_kmh:.1f} km/h within {bound.window_s:g} s"
    weak = "" if bound.reliable else f" At {bound.sample_rate_hz:.0f} samples/s a short pulse may stay unseen."
    if verdict == "no_pulse":
        return f"The data cover the whole window and show {limit}, driving included.{weak}"
    share = f"The data cover {100.0 * covered:.0f} % of the window"
    return f"{share} and show {limit} there; of the rest nothing is known.{weak}"
