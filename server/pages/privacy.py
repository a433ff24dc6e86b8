"""The administrator's page about privacy: how long data are kept, legal holds, erasure and export."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse, RedirectResponse, Response

from server.accounts import audit, users
from server.accounts.access import Caller, PrivacyManager
from server.database import Database
from server.edge import DatabaseOf, Now
from server.errors import ForbiddenError, InvalidError, ProblemError
from server.models import Event, Vehicle
from server.models.privacy import DATA_CLASSES
from server.pages import queries
from server.pages.forms import Text, day
from server.pages.routes import answer
from server.privacy import erasure, policy
from server.wording import marked

router = APIRouter(include_in_schema=False, default_response_class=HTMLResponse)

MAX_DAYS = 36500
CLASS_WORDS = {
    "raw": marked("Raw samples"),
    "tracks": marked("Tracks"),
    "trips": marked("Trips"),
    "manoeuvres": marked("Manoeuvres"),
    "events": marked("Crashes"),
    "diagnosis": marked("Diagnosis values"),
    "alerts": marked("Alerts"),
    "changes": marked("Live changes"),
    "audit": marked("Audit log"),
}
THINGS = {
    "events": marked("Events"),
    "event": marked("event"),
    "batches": marked("Uploads"),
    "trips": marked("Trips"),
    "track_points": marked("Positions of tracks"),
    "alerts": marked("Alerts"),
    "claims": marked("Accident claims"),
    "diagnosis": marked("Diagnosis values"),
    "changes": marked("Live changes"),
    "analyses": marked("Analyses"),
    "installations": marked("Installations"),
    "account": marked("Account"),
    "sessions": marked("Sessions"),
    "sign-in codes": marked("Sign-in codes"),
    "API keys": marked("API keys"),
    "names": marked("Mentions of the name"),
    "alert recipients": marked("Alert channels with the address"),
    "audit entries": marked("entries of the audit log"),
    "event actions": marked("reviews and holds of events"),
    "orders of erasure": marked("orders of erasure"),
    "name and plate": marked("name and plate"),
}


@router.get("/privacy")
def privacy_page(request: Request, caller: PrivacyManager, database: DatabaseOf, now: Now, said: str = "") -> Response:
    """Rules, holds, orders of erasure."""
    words = {
        "rules": marked("The rules are saved and apply from now on."),
        "ordered": marked("The erasure is ordered. A worker carries it out; its line below says when it is finished."),
    }
    return _page(request, caller, database, now, said=words.get(said))


def _page(
    request: Request,
    caller: Caller,
    database: Database,
    now: dt.datetime,
    *,
    said: str | None = None,
    problem: ProblemError | None = None,
    plan: dict[str, Any] | None = None,
) -> HTMLResponse:
    with database.reading() as session:
        context = _context(session, caller, now)
        change = queries.last_change(session, caller.organisation_id)
    shown = {"done": said, "error": None if problem is None else problem.detail, "plan": plan}
    page = answer(request, "privacy.html", caller, "admin", change, {**context, **shown})
    page.status_code = 200 if problem is None else problem.status
    return page


def _context(session: Session, caller: Caller, now: dt.datetime) -> dict[str, Any]:
    organisation_id = caller.organisation_id
    held = select(Event).where(Event.organisation_id == organisation_id, Event.held_at.is_not(None))
    of_organisation = select(Vehicle).where(Vehicle.organisation_id == organisation_id)
    vehicles = session.scalars(of_organisation.order_by(Vehicle.name, Vehicle.id)).all()
    people = users.users(session, organisation_id) if caller.may("users.manage") else []
    names = {vehicle.id: vehicle.name for vehicle in vehicles} | {user.id: user.email for user in people}
    return {
        "rules": policy.rules(session, organisation_id, now=now),
        "now": now,
        "class_words": CLASS_WORDS,
        "things": THINGS,
        "meanings": policy.MEANINGS,
        "holds": session.scalars(held.order_by(Event.held_at.desc(), Event.id)).all(),
        "vehicles": vehicles,
        "users": people,
        "names": names,
        "erasures": erasure.erasures(session, organisation_id),
    }


async def _typed_days(request: Request) -> dict[str, str]:
    """Days as they were typed; an empty field says something here, which the framework's forms would not tell."""
    form = await request.form()
    return {name: str(form[name]) for name in DATA_CLASSES if name in form}


TypedDays = Annotated[dict[str, str], Depends(_typed_days)]


@router.post("/privacy/retention")
def set_rules(request: Request, caller: PrivacyManager, database: DatabaseOf, now: Now, typed: TypedDays) -> Response:
    """Save how long data are kept; an empty field keeps without end."""
    try:
        wanted = {name: _days(name, text) for name, text in typed.items()}
        with database.transaction() as session:
            # The form sends every field: a rule that was left alone stays whose it was.
            before = {rule.data_class: rule.days for rule in policy.rules(session, caller.organisation_id, now=now)}
            wanted = {name: days for name, days in wanted.items() if days != before[name]}
            changed = policy.set_rules(session, caller.organisation_id, wanted, actor=caller.name, now=now)
            told = {"days": changed}
            audit.record(session, caller, "retention.set", "rules", now=now, detail=told)
    except ProblemError as error:
        return _page(request, caller, database, now, problem=error)
    return RedirectResponse("/privacy?said=rules", 303)


def _days(name: str, text: str) -> int | None:
    text = text.strip()
    if not text:
        return None
    if not text.isdecimal() or not 1 <= int(text) <= MAX_DAYS:
        raise InvalidError(f"{CLASS_WORDS[name]}: days from 1 to {MAX_DAYS}, or nothing to keep them without end")
    return int(text)


@router.post("/privacy/erasure")
def erase(
    request: Request,
    caller: PrivacyManager,
    database: DatabaseOf,
    now: Now,
    subject: Text = "",
    reason: Text = "",
    since: Text = "",
    until: Text = "",
    act: Text = "plan",
) -> Response:
    """Say what an erasure would do, or order it."""
    try:
        kind, subject_id = _subject(caller, subject)
        # Days of the calendar, UTC: the last one is included.
        first, last = day(since), day(until, following=1)
        period = {"since": first, "until": last}
        if kind == "user" and (first or last):
            raise InvalidError("Only a vehicle's data can be erased by the day")
        if not reason.strip():
            raise InvalidError("Say why: the reason stands in the certificate")
        if act == "erase":
            with database.transaction() as session:
                erasure.order(session, caller, kind, subject_id, reason=reason.strip(), now=now, **period)
            return RedirectResponse("/privacy?said=ordered", 303)
        with database.reading() as session:
            found = erasure.plan(session, caller, kind, subject_id, **period)
    except ProblemError as error:
        return _page(request, caller, database, now, problem=error)
    form = {"subject": subject, "reason": reason, "since": since, "until": until}
    told = {**found, "form": form, "kind": kind, "id": subject_id}
    return _page(request, caller, database, now, plan=told)


def _subject(caller: Caller, subject: str) -> tuple[str, str]:
    kind, _, subject_id = subject.partition(":")
    if kind not in ("vehicle", "user") or len(subject_id) > 32:
        raise InvalidError("Choose a vehicle or a person")
    if kind == "user" and not caller.may("users.manage"):
        raise ForbiddenError("Needs the permission users.manage")
    return kind, subject_id
