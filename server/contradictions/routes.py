"""Contradictions around events, and claims, over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query

from server.accounts import audit
from server.accounts.access import RawReader, Reader, Reviewer
from server.contradictions import queries, service
from server.contradictions.schemas import ClaimIn, ClaimOut, ContradictionsOut
from server.edge import DatabaseOf, Now, StoreOf
from server.events.queries import event_of

router = APIRouter(prefix="/api/v1", tags=["contradictions"])

Id = Annotated[str, Path(max_length=32)]


@router.get("/events/{event_id}/contradictions")
def read_contradictions(event_id: Id, caller: Reader, database: DatabaseOf) -> ContradictionsOut:
    """What stands against an event or casts doubt on its data, looked for now."""
    with database.reading() as session:
        event = event_of(session, caller.organisation_id, event_id)
        items = queries.contradictions(session, event)
    return ContradictionsOut(event_id=event.id, checked=list(queries.CHECKED), items=items)


@router.post("/accident-claims", status_code=201)
def register(
    wanted: ClaimIn,
    caller: Reviewer,
    _raw: RawReader,
    database: DatabaseOf,
    store: StoreOf,
    now: Now,
) -> ClaimOut:
    """Say that a vehicle had an accident; the answer says what the recorded data show."""
    with database.reading() as session:
        boxes = service.boxes_of(session, caller.organisation_id, wanted)
        parts = service.pieces_of(session, boxes, wanted)
    samples = [service.read(store, each, wanted) for each in parts]
    with database.transaction() as session:
        row = service.register(session, caller.organisation_id, wanted, boxes, samples, actor=caller.name, now=now)
        subject = f"vehicle={wanted.vehicle_id} claim={row.id}"
        audit.record(session, caller, "claim.registered", subject, now=now)
        return queries.claim_out(row)


@router.get("/accident-claims")
def list_claims(
    caller: Reviewer,
    database: DatabaseOf,
    vehicle: Annotated[str | None, Query(max_length=32)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> list[ClaimOut]:
    """Claims and what was answered, the newest first."""
    with database.reading() as session:
        return [
            queries.claim_out(row)
            for row in queries.claims(session, caller.organisation_id, vehicle_id=vehicle, limit=limit)
        ]


@router.get("/accident-claims/{claim_id}")
def read_claim(claim_id: Id, caller: Reviewer, database: DatabaseOf) -> ClaimOut:
    """One claim."""
    with database.reading() as session:
        return queries.claim_out(queries.claim_of(session, caller.organisation_id, claim_id))
