"""Diagnosis values as they are shown."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence

from sqlalchemy import and_, func, select
from sqlalchemy.orm import Session

from server.models import Diagnosis

MAX_READINGS = 20_000


def newest(
    session: Session, device_id: str, names: Collection[str] | None = None, *, before: dt.datetime | None = None
) -> Sequence[Diagnosis]:
    """The newest value of each name, by name."""
    last = select(Diagnosis.name, func.max(Diagnosis.at).label("at")).where(Diagnosis.device_id == device_id)
    if names is not None:
        last = last.where(Diagnosis.name.in_(names))
    if before is not None:
        last = last.where(Diagnosis.at < before)
    found = last.group_by(Diagnosis.name).subquery()
    same = and_(Diagnosis.name == found.c.name, Diagnosis.at == found.c.at, Diagnosis.device_id == device_id)
    return session.scalars(select(Diagnosis).join(found, same).order_by(Diagnosis.name)).all()


def around(
    session: Session, device_id: str, names: Collection[str], since: dt.datetime, until: dt.datetime
) -> list[Diagnosis]:
    """Values of some names within a time, and the newest of each before it, in the order of time."""
    within = select(Diagnosis).where(
        Diagnosis.device_id == device_id, Diagnosis.name.in_(names), Diagnosis.at >= since, Diagnosis.at <= until
    )
    return [
        *newest(session, device_id, names, before=since),
        *session.scalars(within.order_by(Diagnosis.at)),
    ]


def readings(
    session: Session, device_id: str, name: str, since: dt.datetime, until: dt.datetime
) -> Sequence[Diagnosis]:
    """Values of one name in the order of time, the newest `MAX_READINGS`."""
    wanted = select(Diagnosis).where(
        Diagnosis.device_id == device_id, Diagnosis.name == name, Diagnosis.at >= since, Diagnosis.at <= until
    )
    found = session.scalars(wanted.order_by(Diagnosis.at.desc()).limit(MAX_READINGS)).all()
    return list(reversed(found))
