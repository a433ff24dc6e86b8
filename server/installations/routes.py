"""How boxes sit in their vehicles, over HTTP."""

from __future__ import annotations

import datetime as dt
from typing import Annotated

from fastapi import APIRouter, Query
from sqlalchemy.orm import Session

from server.accounts import audit
from server.accounts.access import Caller, Installer, Reader
from server.devices.queries import device_of
from server.edge import DatabaseOf, Now, StoreOf
from server.installations import level, queries, service
from server.installations.schemas import (
    History,
    InstallationOut,
    LevelOut,
    ManualMounting,
    installation_out,
    level_out,
)

router = APIRouter(prefix="/api/v1/devices/{device_id}", tags=["installations"])


@router.get("/installation")
def read_current(device_id: str, caller: Reader, database: DatabaseOf) -> InstallationOut:
    """The present mounting of a box; `insufficient` before any data."""
    with database.reading() as session:
        device_of(session, caller.organisation_id, device_id)
        return installation_out(device_id, queries.current(session, device_id))


@router.get("/installations")
def read_history(
    device_id: str,
    caller: Reader,
    database: DatabaseOf,
    revisions: Annotated[bool, Query(description="with the estimates as they stood")] = False,
) -> History:
    """All installations of a box, the newest first."""
    with database.reading() as session:
        device_of(session, caller.organisation_id, device_id)
        rows = queries.history(session, device_id)
        found = queries.revisions(session, [row.id for row in rows]) if revisions else {}
        return History(items=[installation_out(device_id, row, found.get(row.id)) for row in rows])


@router.get("/level")
def read_level(device_id: str, caller: Reader, database: DatabaseOf, store: StoreOf, now: Now) -> LevelOut:
    """What the box feels just now: for levelling it by hand, and for the live arrows of the 3D view."""
    with database.reading() as session:
        device_of(session, caller.organisation_id, device_id)
        found = level.sources(session, device_id)
        row = queries.current(session, device_id)
        known = row is not None and row.status in ("ready", "settling")
        R_va = row.result.get("R_va") if row is not None and known else None
    return level_out(level.feel(store, found), R_va, now=now)


@router.put("/installation")
def set_manual(
    device_id: str, wanted: ManualMounting, caller: Installer, database: DatabaseOf, now: Now
) -> InstallationOut:
    """Set a measured mounting; it holds until the box is seen to move."""
    with database.transaction() as session:
        row = service.set_manual(
            session,
            caller.organisation_id,
            device_id,
            wanted.matrix(),
            reason=wanted.reason,
            sigma_deg=wanted.sigma_deg.model_dump() if wanted.sigma_deg else None,
            since=wanted.since or now,
            now=now,
        )
        note_manual(session, caller, device_id, wanted.reason, now=now)
        return installation_out(device_id, row)


def note_manual(session: Session, caller: Caller, device_id: str, reason: str, *, now: dt.datetime) -> None:
    """Tell the audit log who said how a box is mounted, and why."""
    audit.record(session, caller, "mounting.manual", f"device={device_id}", now=now, detail={"reason": reason})
