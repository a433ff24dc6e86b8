"""The report over HTTP."""

from __future__ import annotations

from hashlib import sha256

from fastapi import APIRouter
from starlette.responses import Response

from server.accounts.access import LocationReader
from server.contradictions.queries import contradictions
from server.edge import DatabaseOf
from server.events.routes import EventId, Language, Revision, Subject, attachment, subject_of
from server.reports.pdf import Heading, report_pdf

router = APIRouter(prefix="/api/v1/events", tags=["events"])

MEDIA_TYPE = "application/pdf"


def heading_of(subject: Subject) -> Heading:
    """What the report calls things: as they were called when the revision was computed."""
    return Heading(
        event_id=subject.event.id,
        revision=subject.revision.number,
        event_sha256=subject.revision.event_sha256,
        device_name=subject.revision.device_name or subject.event.device_id,
        vehicle_name=subject.revision.vehicle_name,
        plate=subject.revision.plate,
    )


@router.get(
    "/{event_id}/report.pdf",
    response_class=Response,
    responses={200: {"content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}},
)
def read_report(
    event_id: EventId, caller: LocationReader, database: DatabaseOf, lang: Language = "en", revision: Revision = None
) -> Response:
    """The report of a revision, English or Italian, with the contradictions that are found now."""
    subject = subject_of(database, caller, event_id, revision)
    with database.reading() as session:
        found = [(each.code, each.detail) for each in contradictions(session, subject.event)]
    content = report_pdf(subject.document, heading_of(subject), lang, found)
    response = attachment(content, MEDIA_TYPE, subject, f"report-{lang}.pdf")
    response.headers["ETag"] = f'"{sha256(content).hexdigest()[:32]}"'
    return response
