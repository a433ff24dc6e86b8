"""What a legal hold keeps: the event, its batches and trip, alerts raised for it, claims of an accident at its time.

Its batches are those that it rests on and those that reach into its window.

Also the batches that come after the hold was placed: the question is asked of the rows whenever something is to go.
"""

from __future__ import annotations

from sqlalchemy import ColumnElement, and_, or_, select

from server.models import AccidentClaim, Alert, Batch, Event, EventInput, Trip

BEFORE_S, AFTER_S = 40.0, 35.0
"""What a reconstruction takes in around a severe event."""


def held() -> ColumnElement[bool]:
    """Whether a batch is kept by a legal hold."""
    return _rests_on_batch(Event.held_at.is_not(None))


def evidence() -> ColumnElement[bool]:
    """Whether a severe event rests on a batch: raw data are then kept as long as the event."""
    return _rests_on_batch(Event.severe.is_(True), Event.erased_at.is_(None), Event.withdrawn_at.is_(None))


def trip_held() -> ColumnElement[bool]:
    """Whether a held event happened during a trip."""
    within = and_(Trip.t_first_s - AFTER_S <= Event.t0_s, Event.t0_s <= Trip.t_last_s + BEFORE_S)
    same = Event.device_id == Trip.device_id, Event.boot == Trip.boot
    return select(Event.id).where(*same, within, Event.held_at.is_not(None)).correlate(Trip).exists()


def alert_held() -> ColumnElement[bool]:
    """Whether an alert was raised for a held event."""
    of_alert = select(Event.id).where(Event.id == Alert.event_id, Event.held_at.is_not(None))
    return of_alert.correlate(Alert).exists()


def claim_held() -> ColumnElement[bool]:
    """Whether a held event happened within the time that a claim of an accident names."""
    within = AccidentClaim.began_at <= Event.at, Event.at <= AccidentClaim.ended_at
    same = Event.vehicle_id == AccidentClaim.vehicle_id
    return select(Event.id).where(same, *within, Event.held_at.is_not(None)).correlate(AccidentClaim).exists()


def _rests_on_batch(*wanted: ColumnElement[bool]) -> ColumnElement[bool]:
    window = (
        select(Event.id)
        .where(Event.device_id == Batch.device_id, Event.boot == Batch.boot, *wanted)
        .where(Batch.t_last_s >= Event.t0_s - BEFORE_S, Batch.t_first_s <= Event.t_end_s + AFTER_S)
    )
    named = (
        select(Event.id)
        .join(EventInput, EventInput.event_id == Event.id)
        .where(EventInput.batch_id == Batch.id, *wanted)
    )
    return or_(window.correlate(Batch).exists(), named.correlate(Batch).exists())
