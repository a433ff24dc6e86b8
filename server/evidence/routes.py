"""The archive of evidence over HTTP."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from server.accounts.access import LocationReader, RawReader
from server.edge import DatabaseOf, SettingsOf, StoreOf
from server.events import queries
from server.events.routes import EventId, attachment, subject_of
from server.evidence.package import archive, material
from server.reports.routes import heading_of

router = APIRouter(prefix="/api/v1/events", tags=["events"])

MEDIA_TYPE = "application/zip"


@router.get(
    "/{event_id}/evidence.zip",
    response_class=Response,
    responses={200: {"content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}},
)
def read_evidence(
    event_id: EventId,
    caller: RawReader,
    _located: LocationReader,
    database: DatabaseOf,
    store: StoreOf,
    settings: SettingsOf,
) -> Response:
    """Raw data, report, event, chain, and a verifier that needs nothing but Python."""
    subject = subject_of(database, caller, event_id, None)
    with database.reading() as session:
        revisions = [(row.number, queries.canonical_bytes(row)) for row in queries.revisions(session, event_id)]
        found = material(session, subject.event.device_id, subject.batches, revisions)
    content = archive(found, subject.document, heading_of(subject), store, settings)
    return attachment(content, MEDIA_TYPE, subject, "evidence.zip")
