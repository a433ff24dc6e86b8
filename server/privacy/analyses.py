"""The workbench's analyses of a vehicle's trips: their results hold the way that was driven.

First they are closed, which hides them; a row goes once its result does, so that no order is called finished before.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Iterator

from sqlalchemy import ColumnElement, delete, func, or_, select, update
from sqlalchemy.orm import Session

from server.database import Database
from server.models import Analysis
from server.privacy import subjects
from server.privacy.subjects import Subject
from server.store import COLLECT_AGE, BlobStore

CLOSED = "erased"
_AT_ONCE = 200


def wanted(session: Session, subject: Subject) -> list[ColumnElement[bool]]:
    """Conditions of the vehicle's analyses: of stored data, which go by the middle of their time as batches do."""
    found: list[ColumnElement[bool]] = []
    for stay in subjects.stays(session, subject):
        for boot in subjects.boots_of(session, stay):
            begin, end = boot.box_s(stay.began_at.timestamp()), boot.box_s(stay.ended_at.timestamp())
            middle = 0.5 * (Analysis.t_first_s + Analysis.t_last_s)
            found.append(
                (Analysis.device_id == stay.device_id)
                & (Analysis.boot == boot.boot)
                & (middle >= begin)
                & (middle < end)
            )
    return found


def count(session: Session, subject: Subject) -> int:
    """How many there are."""
    of_vehicle = wanted(session, subject)
    if not of_vehicle:
        return 0
    return session.scalar(select(func.count(Analysis.id)).where(or_(*of_vehicle))) or 0


def close(session: Session, subject: Subject) -> int:
    """Hide them: neither their name nor their result is shown from now on; how many."""
    of_vehicle = wanted(session, subject)
    if not of_vehicle:
        return 0
    open_still = or_(*of_vehicle), Analysis.name != CLOSED
    ids = list(session.scalars(select(Analysis.id).where(*open_still).limit(_AT_ONCE)))
    hidden = {"name": CLOSED, "status": "cancelled", "stage": "", "error": None, "leased_until": None}
    session.execute(update(Analysis).where(Analysis.id.in_(ids)).values(hidden))
    return len(ids)


def finish(
    database: Database,
    store: BlobStore,
    subject: Subject,
    *,
    now: dt.datetime,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Delete the results of closed ones, and their rows once those are gone; what was put lately waits a day."""
    for analysis_id, key in _closed(database, subject):
        if stopped():
            return
        with database.reading() as session:
            # The same data analysed the same way give the same result: it stays with whoever else has it.
            others = select(Analysis.id).where(Analysis.result_key == key, Analysis.id != analysis_id)
            shared = key is not None and session.scalar(others.limit(1)) is not None
        if key is None or shared or store.delete_stale(key, now - COLLECT_AGE):
            with database.transaction() as session:
                session.execute(delete(Analysis).where(Analysis.id == analysis_id))


def _closed(database: Database, subject: Subject) -> Iterator[tuple[str, str | None]]:
    with database.reading() as session:
        of_vehicle = wanted(session, subject)
        if not of_vehicle:
            return
        query = select(Analysis.id, Analysis.result_key).where(or_(*of_vehicle), Analysis.name == CLOSED)
        rows = session.execute(query.order_by(Analysis.id)).all()
    for row in rows:
        yield row.id, row.result_key


def delete_old(session: Session, organisation_id: str, before: dt.datetime) -> int:
    """Delete the first of an organisation's analyses made before a moment; the collector takes their files."""
    old = Analysis.organisation_id == organisation_id, Analysis.created_at < before
    ids = list(session.scalars(select(Analysis.id).where(*old).order_by(Analysis.created_at).limit(_AT_ONCE)))
    session.execute(delete(Analysis).where(Analysis.id.in_(ids)))
    return len(ids)
