"""`scatola erase`: erase what is held about a vehicle or a person, at once, and print the certificate."""

from __future__ import annotations

import argparse
import datetime as dt
import json
from typing import Any

from sqlalchemy.orm import Session

from server.accounts.caller import Caller
from server.database import Database
from server.evidence.seal import signing_key
from server.models import User, Vehicle
from server.privacy import erasure
from server.privacy.certificate import certificate
from server.settings import Settings
from server.store import open_store


def erase(args: argparse.Namespace) -> int:
    """Status 0 when it is done or under way, also where a legal hold keeps a part."""
    period = {"since": _moment(args.since, "--from"), "until": _moment(args.until, "--to")}
    if args.kind == "user" and any(period.values()):
        raise ValueError("--from and --to are for vehicles")
    if not args.dry_run and not args.reason:
        raise ValueError("give a --reason: it stands in the certificate")
    settings = Settings()
    database = Database(settings)
    try:
        with database.transaction() as session:
            caller = _operator(session, args.kind, args.id)
            now = dt.datetime.now(dt.UTC)
            if args.dry_run:
                _print(erasure.plan(session, caller, args.kind, args.id, **period), as_json=args.json)
                return 0
            row = erasure.order(session, caller, args.kind, args.id, reason=args.reason, now=now, **period)
        finished = erasure.run(database, open_store(settings), row.id, now=now)
        with database.reading() as session:
            row = erasure.erasure_of(session, row.organisation_id, row.id)
            told = (
                certificate(session, row, signing_key(settings))
                if finished
                else _under_way(row.id, row.erased, row.kept)
            )
        _print(told, as_json=args.json)
    finally:
        database.dispose()
    return 0


def _operator(session: Session, kind: str, subject_id: str) -> Caller:
    row = session.get(Vehicle if kind == "vehicle" else User, subject_id)
    if row is None:
        raise ValueError(f"there is no {kind} {subject_id}")
    return Caller(row.organisation_id, "job", name="command line")


def _under_way(erasure_id: str, erased: dict[str, Any], kept: list[Any]) -> dict[str, Any]:
    why = "raw data stored less than a day ago are deleted by the worker; nobody reads them any more"
    return {"erasure_id": erasure_id, "finished_at": None, "waiting": why, "erased": erased, "kept": kept}


def _moment(text: str | None, option: str) -> dt.datetime | None:
    if text is None:
        return None
    try:
        found = dt.datetime.fromisoformat(text)
        return (found.replace(tzinfo=dt.UTC) if found.tzinfo is None else found).astimezone(dt.UTC)
    except (ValueError, OverflowError):
        raise ValueError(f"{option} {text!r} is no time such as 2026-03-01T12:00:00Z") from None


def _print(told: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(told))
        return
    for heading, name in (("erased", "erased"), ("would erase", "would_erase")):
        for what, count in told.get(name, {}).items():
            print(f"{heading}  {count:>9}  {what.replace('_', ' ')}")
    for kept in told.get("kept", told.get("would_keep", [])):
        print(f"kept    {kept['count']:>9}  {kept['what']}{' ' + kept['id'] if kept['id'] else ''}: {kept['why']}")
    if "erasure_id" in told:
        print(f"erasure {told['erasure_id']}: {'finished' if told['finished_at'] else told['waiting']}")
