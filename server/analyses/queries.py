"""Analyses as they are read; pages, API and worker ask the same."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence

from sqlalchemy import and_, func, or_, select
from sqlalchemy.orm import Session

from server.errors import NotFoundError
from server.models import Analysis, Batch


def analysis_of(session: Session, organisation_id: str, analysis_id: str) -> Analysis:
    """An analysis of the organisation."""
    found = session.get(Analysis, analysis_id)
    if found is None or found.organisation_id != organisation_id:
        raise NotFoundError(f"There is no analysis {analysis_id!r}")
    return found


def analyses(session: Session, organisation_id: str, *, limit: int) -> Sequence[Analysis]:
    """The newest first."""
    query = select(Analysis).where(Analysis.organisation_id == organisation_id)
    return session.scalars(query.order_by(Analysis.created_at.desc(), Analysis.id).limit(limit)).all()


def usage(session: Session, organisation_id: str) -> tuple[int, int]:
    """How many analyses an organisation keeps, and how many bytes of files."""
    count, size = session.execute(
        select(func.count(Analysis.id), func.coalesce(func.sum(Analysis.input_bytes), 0)).where(
            Analysis.organisation_id == organisation_id
        )
    ).one()
    return int(count), int(size)


def waiting(session: Session, organisation_id: str) -> int:
    """How many are not finished."""
    query = select(func.count(Analysis.id)).where(
        Analysis.organisation_id == organisation_id, Analysis.status.in_(("waiting", "running"))
    )
    return session.scalar(query) or 0


def due(session: Session, *, now: dt.datetime) -> str | None:
    """The oldest that waits, or whose worker has not been heard of; what is due stands in the database."""
    left = and_(Analysis.status == "running", Analysis.leased_until < now)
    query = select(Analysis.id).where(or_(Analysis.status == "waiting", left))
    return session.scalars(query.order_by(Analysis.created_at).limit(1)).first()


def batches(session: Session, analysis: Analysis) -> Sequence[Batch]:
    """The batches that a trip's stretch of the clock reaches into, in the order of time."""
    return session.scalars(
        select(Batch)
        .where(Batch.device_id == analysis.device_id, Batch.boot == analysis.boot, Batch.failure.is_(None))
        .where(Batch.erasing_at.is_(None))
        .where(Batch.t_last_s >= analysis.t_first_s, Batch.t_first_s <= analysis.t_last_s)
        .order_by(Batch.t_first_s, Batch.id)
    ).all()
