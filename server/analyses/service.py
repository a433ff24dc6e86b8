"""Asking for analyses, giving them up, throwing them away; and the worker's side of the same rows."""

from __future__ import annotations

import datetime as dt
from typing import Any, cast

from sqlalchemy import CursorResult, select, update
from sqlalchemy.orm import Session

from server.accounts.caller import Caller
from server.analyses import queries
from server.analyses.kinds import Kind
from server.errors import ConflictError, ForbiddenError, TooLargeError, TooManyRequestsError
from server.live.changes import announce
from server.models import Analysis, Device, Trip, Vehicle
from server.store import blob_key

FOLDER = "workbench"
"""Stands where other blob keys have their device."""
MOST = 500
MOST_BYTES = 4 * 1024**3
"""An organisation keeps at most so many analyses, with so many bytes of files."""
MOST_WAITING = 20
ATTEMPTS = 3
LEASE = dt.timedelta(seconds=30)
STOPPED = "The analysis ended its worker {} times and is given up; is the recording too large?"


def file_key(organisation_id: str, sha256: str, kind: str) -> str:
    """Where an uploaded file (``input``) or a result (``json``) lies."""
    return blob_key(organisation_id, FOLDER, sha256, kind)


def check_room(session: Session, organisation_id: str, size: int) -> None:
    """Raise unless the organisation may add one more."""
    count, used = queries.usage(session, organisation_id)
    if count >= MOST:
        raise ConflictError(f"There are {count} analyses; delete some first", code="too_many_analyses")
    if used + size > MOST_BYTES:
        raise TooLargeError(f"The files of all analyses are more than {MOST_BYTES} bytes; delete some first")
    if queries.waiting(session, organisation_id) >= MOST_WAITING:
        raise TooManyRequestsError(f"{MOST_WAITING} analyses are waiting; try again when some are done")


def of_file(
    session: Session,
    caller: Caller,
    kind: Kind,
    parameters: dict[str, Any],
    *,
    name: str,
    sha256: str,
    size: int,
    now: dt.datetime,
) -> Analysis:
    """Ask for an analysis of a stored file."""
    row = _new(caller, kind, name, parameters, now)
    row.input_key = file_key(caller.organisation_id, sha256, "input")
    row.input_sha256, row.input_bytes = sha256, size
    return _added(session, row, now)


def of_trip(
    session: Session, caller: Caller, kind: Kind, parameters: dict[str, Any], trip: Trip, *, now: dt.datetime
) -> Analysis:
    """Ask for an analysis of the stored data of a trip."""
    vehicle = None if trip.vehicle_id is None else session.get(Vehicle, trip.vehicle_id)
    named = vehicle or session.get_one(Device, trip.device_id)
    row = _new(caller, kind, f"{named.name}, {trip.began_at:%Y-%m-%d %H:%M} UTC", parameters, now)
    row.device_id, row.boot, row.t_first_s, row.t_last_s = trip.device_id, trip.boot, trip.t_first_s, trip.t_last_s
    return _added(session, row, now)


def again(
    session: Session, caller: Caller, kind: Kind, parameters: dict[str, Any], before: Analysis, *, now: dt.datetime
) -> Analysis:
    """Ask for another analysis of the same recording."""
    row = _new(caller, kind, before.name, parameters, now)
    for column in ("device_id", "boot", "t_first_s", "t_last_s", "input_key", "input_bytes", "input_sha256"):
        setattr(row, column, getattr(before, column))
    return _added(session, row, now)


def _new(caller: Caller, kind: Kind, name: str, parameters: dict[str, Any], now: dt.datetime) -> Analysis:
    return Analysis(
        organisation_id=caller.organisation_id,
        user_id=caller.user_id,
        creator=caller.name[:254],
        kind=kind,
        name=name[:200],
        parameters=parameters,
        status="waiting",
        created_at=now,
    )


def _added(session: Session, row: Analysis, now: dt.datetime) -> Analysis:
    session.add(row)
    session.flush()
    tell(session, row, row.status, now=now)
    return row


def tell(session: Session, row: Analysis, status: str, *, now: dt.datetime) -> None:
    """Announce how an analysis stands."""
    data = {"analysis_id": row.id, "status": status}
    announce(session, "analysis", at=now, organisation_id=row.organisation_id, data=data)


def cancel(session: Session, organisation_id: str, analysis_id: str, *, now: dt.datetime) -> Analysis:
    """Give an analysis up; one that is finished stays as it is."""
    row = queries.analysis_of(session, organisation_id, analysis_id)
    # As it stands now, not as it was read: a worker may just have finished it.
    open_still = update(Analysis).where(Analysis.id == row.id, Analysis.status.in_(("waiting", "running")))
    if _changed(session, open_still.values(status="cancelled", stage="", finished_at=now, leased_until=None)):
        session.refresh(row)
        tell(session, row, row.status, now=now)
    return row


def may_delete(caller: Caller, row: Analysis) -> bool:
    """Whether an analysis is the caller's own, or the caller an administrator."""
    return caller.may("fleet.write") or (caller.user_id is not None and caller.user_id == row.user_id)


def delete(session: Session, caller: Caller, analysis_id: str, *, now: dt.datetime) -> None:
    """Throw an analysis away, one's own or as an administrator; its files are collected within a day."""
    row = queries.analysis_of(session, caller.organisation_id, analysis_id)
    if not may_delete(caller, row):
        raise ForbiddenError("Only who asked for an analysis, or an administrator, may delete it")
    if row.status in ("waiting", "running"):
        raise ConflictError("Cancel the analysis before you delete it", code="analysis_open")
    tell(session, row, "deleted", now=now)
    session.delete(row)


# --- the worker's side


def claim(session: Session, analysis_id: str, *, now: dt.datetime) -> Analysis | None:
    """Begin an analysis that is due; None when another worker was faster or it has had its attempts."""
    row = session.scalars(select(Analysis).where(Analysis.id == analysis_id).with_for_update()).first()
    if row is None or not (row.status == "waiting" or (row.status == "running" and _lapsed(row, now))):
        return None
    if row.attempts >= ATTEMPTS:
        row.status, row.error, row.finished_at = "failed", STOPPED.format(row.attempts), now
        tell(session, row, row.status, now=now)
        return None
    row.status, row.progress, row.stage = "running", 0.0, ""
    row.attempts += 1
    row.leased_until = now + LEASE
    session.flush()
    tell(session, row, row.status, now=now)
    return row


def _lapsed(row: Analysis, now: dt.datetime) -> bool:
    return row.leased_until is None or row.leased_until < now


def renew(session: Session, analysis_id: str, attempt: int, *, now: dt.datetime) -> bool:
    """Keep an analysis; False when it was cancelled, deleted or given to another worker."""
    return _changed(session, _held(analysis_id, attempt).values(leased_until=now + LEASE))


def report(session: Session, row: Analysis, attempt: int, stage: str, progress: float, *, now: dt.datetime) -> bool:
    """Say how far an analysis is; False as for `renew`."""
    held = _changed(session, _held(row.id, attempt).values(stage=stage[:200], progress=min(max(progress, 0.0), 1.0)))
    if held:
        tell(session, row, "running", now=now)
    return held


def finish(session: Session, row: Analysis, attempt: int, values: dict[str, Any], *, now: dt.datetime) -> bool:
    """Store how an analysis ended; False, and nothing changed, as for `renew`."""
    done = {"finished_at": now, "leased_until": None, "stage": "", **values}
    if not _changed(session, _held(row.id, attempt).values(**done)):
        return False
    tell(session, row, values["status"], now=now)
    return True


def _held(analysis_id: str, attempt: int) -> Any:
    return update(Analysis).where(
        Analysis.id == analysis_id, Analysis.status == "running", Analysis.attempts == attempt
    )


def _changed(session: Session, statement: Any) -> bool:
    return cast("CursorResult[Any]", session.execute(statement)).rowcount == 1
