"""The report over HTTP."""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from server.accounts.access import LocationReader, Reader
from server.contradictions.queries import contradictions
from server.edge import DatabaseOf
from server.events.routes import EventId, Language, Revision, Subject, attachment, subject_of
from server.installations.certificate import certificate_of
from server.problems import described
from server.reports.certificate import certificate_pdf
from server.reports.pdf import Heading, report_pdf
from server.view3d.uncertainty import widest_deg

router = APIRouter()

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
    "/api/v1/events/{event_id}/report.pdf",
    tags=["events"],
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


@router.get(
    "/api/v1/devices/{device_id}/installation/certificate.pdf",
    tags=["installations"],
    response_class=Response,
    responses={
        200: {"content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}},
        **described(409),
    },
)
def read_certificate(
    request: Request,
    device_id: str,
    caller: Reader,
    database: DatabaseOf,
    lang: Language = "en",
    mounting: Annotated[
        str | None,
        Query(max_length=32, description="the estimate that an earlier certificate names; default: the newest"),
    ] = None,
) -> Response:
    """The certificate of a ready mounting; 409 while it is not known well enough."""
    with database.reading() as session:
        found = certificate_of(session, caller.organisation_id, device_id, mounting)
    mounted = found.document["mounting"]
    cones = widest_deg(mounted["R_va"], mounted["sigma_deg"]) if mounted["sigma_deg"] else None
    query = f"mounting={found.id}&sha256={found.sha256}"
    address = f"{request.base_url}devices/{device_id}/certificate?{query}"
    content = certificate_pdf(found, cones, lang, address=address)
    name = f'attachment; filename="certificate-{device_id[:8]}-{lang}.pdf"'
    return Response(content, media_type=MEDIA_TYPE, headers={"Content-Disposition": name})
