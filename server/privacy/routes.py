"""Retention, holds, erasure and export over HTTP."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from sqlalchemy import select
from starlette.responses import StreamingResponse

from server.accounts import audit
from server.accounts.access import (
    Caller,
    LocationReader,
    PrivacyExporter,
    PrivacyManager,
    RawReader,
    UserManager,
)
from server.accounts.users import user_of
from server.edge import DatabaseOf, Moment, Now, SettingsOf, StoreOf
from server.evidence.seal import readable_key
from server.models import Event
from server.privacy import erasure, export, policy, subjects
from server.privacy.certificate import certificate
from server.privacy.schemas import (
    ErasureIn,
    ErasureOut,
    HoldOut,
    PlanOut,
    RuleOut,
    RulesIn,
    UserErasureIn,
    erasure_out,
    hold_out,
    rule_out,
)
from server.problems import described

router = APIRouter(prefix="/api/v1", tags=["privacy"])

Id = Annotated[str, Path(max_length=32)]
ZIP: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}}
}


@router.get("/retention")
def read_rules(caller: PrivacyManager, database: DatabaseOf, now: Now) -> list[RuleOut]:
    """How long each class of data is kept."""
    with database.reading() as session:
        return [rule_out(row) for row in policy.rules(session, caller.organisation_id, now=now)]


@router.put("/retention")
def set_rules(wanted: RulesIn, caller: PrivacyManager, database: DatabaseOf, now: Now) -> list[RuleOut]:
    """Choose how long data are kept; it applies from now on."""
    days: dict[str, int | None] = {**wanted.days}
    with database.transaction() as session:
        changed = policy.set_rules(session, caller.organisation_id, days, actor=caller.name, now=now)
        detail = {"days": changed}
        audit.record(session, caller, "retention.set", "rules", now=now, detail=detail)
        return [rule_out(row) for row in policy.rules(session, caller.organisation_id, now=now)]


@router.get("/holds")
def list_holds(caller: PrivacyManager, database: DatabaseOf) -> list[HoldOut]:
    """Events under a legal hold; `PUT /api/v1/events/{id}/hold` places and ends one."""
    query = select(Event).where(Event.organisation_id == caller.organisation_id, Event.held_at.is_not(None))
    with database.reading() as session:
        return [hold_out(row) for row in session.scalars(query.order_by(Event.held_at.desc(), Event.id))]


@router.post("/vehicles/{vehicle_id}/erasure", status_code=202)
def erase_vehicle(
    vehicle_id: Id, wanted: ErasureIn, caller: PrivacyManager, database: DatabaseOf, now: Now
) -> ErasureOut | PlanOut:
    """Erase what is held about a vehicle, or about whoever drove it in a time; a worker carries it out.

    What a legal hold keeps stays, and is listed.  With `dry_run` nothing is done.
    """
    period = {"since": wanted.since, "until": wanted.until}
    return _order(database, caller, "vehicle", vehicle_id, wanted.reason, period, now, dry_run=wanted.dry_run)


@router.post("/users/{user_id}/erasure", status_code=202, responses=described(409))
def erase_user(
    user_id: Id, wanted: UserErasureIn, caller: PrivacyManager, _people: UserManager, database: DatabaseOf, now: Now
) -> ErasureOut | PlanOut:
    """Erase a person's account; the audit log keeps what it tells until its own retention ends."""
    return _order(database, caller, "user", user_id, wanted.reason, {}, now, dry_run=wanted.dry_run)


def _order(
    database: DatabaseOf,
    caller: Caller,
    kind: str,
    subject_id: str,
    reason: str,
    period: dict[str, dt.datetime | None],
    now: dt.datetime,
    *,
    dry_run: bool,
) -> ErasureOut | PlanOut:
    if dry_run:
        with database.reading() as session:
            return PlanOut.model_validate(erasure.plan(session, caller, kind, subject_id, **period))
    since, until = period.get("since"), period.get("until")
    with database.transaction() as session:
        row = erasure.order(session, caller, kind, subject_id, since=since, until=until, reason=reason, now=now)
        return erasure_out(row)


@router.get("/erasures")
def list_erasures(
    caller: PrivacyManager,
    database: DatabaseOf,
    before: Annotated[str | None, Query(max_length=32, description="id of the last one of the page before")] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> list[ErasureOut]:
    """Orders of erasure, the newest first, a page at a time."""
    with database.reading() as session:
        last = None if before is None else erasure.erasure_of(session, caller.organisation_id, before)
        return [erasure_out(row) for row in erasure.erasures(session, caller.organisation_id, before=last, limit=limit)]


@router.get("/erasures/{erasure_id}")
def read_erasure(erasure_id: Id, caller: PrivacyManager, database: DatabaseOf) -> ErasureOut:
    """One order and how far it is."""
    with database.reading() as session:
        return erasure_out(erasure.erasure_of(session, caller.organisation_id, erasure_id))


@router.get("/erasures/{erasure_id}/certificate", responses=described(409))
def read_certificate(
    erasure_id: Id, caller: PrivacyManager, settings: SettingsOf, database: DatabaseOf
) -> dict[str, Any]:
    """What was erased, with the hashes that stay in the chains of evidence; once it is finished.

    Signed where the operator has a key (docs/privacy.md).
    """
    key = readable_key(settings)
    with database.reading() as session:
        return certificate(session, erasure.erasure_of(session, caller.organisation_id, erasure_id), key)


@router.get("/vehicles/{vehicle_id}/export", response_class=StreamingResponse, responses=ZIP)
def export_vehicle(
    request: Request,
    vehicle_id: Id,
    caller: PrivacyExporter,
    _located: LocationReader,
    _raw: RawReader,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
    since: Annotated[Moment | None, Query(alias="from")] = None,
    until: Annotated[Moment | None, Query(alias="to")] = None,
) -> StreamingResponse:
    """Everything that is held about a vehicle: JSON lines, Parquet, canonical events, raw data."""
    with database.transaction() as session:
        subject = subjects.vehicle_subject(session, caller.organisation_id, vehicle_id, since, until)
        told = {"query": request.url.query[:500]} if request.url.query else {}
        of = f"vehicle {vehicle_id}"
        audit.record(session, caller, "privacy.export", of, now=now, detail=told)
    return _download(export.vehicle_archive(database, store, subject), "vehicle", vehicle_id)


@router.get("/users/{user_id}/export", response_class=StreamingResponse, responses=ZIP)
def export_user(
    user_id: Id, caller: PrivacyExporter, _people: UserManager, database: DatabaseOf, now: Now
) -> StreamingResponse:
    """Everything that is held about a person who signs in: account, sessions, keys, what they did and saw."""
    with database.transaction() as session:
        user = user_of(session, caller, user_id)
        audit.record(session, caller, "privacy.export", f"user {user.id}", now=now)
    return _download(export.user_archive(database, caller.organisation_id, user_id), "user", user_id)


def _download(content: Iterator[bytes], kind: str, subject_id: str) -> StreamingResponse:
    headers = {"Content-Disposition": f"attachment; filename={export.describe(kind, subject_id)}"}
    return StreamingResponse(content, media_type="application/zip", headers=headers)
