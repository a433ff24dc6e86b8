"""Where the e-mail of a person who signs in stands besides the account, and taking it out there.

What answers for others' data keeps it: the audit log, what was said of events, who ordered an erasure.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import func, select, update
from sqlalchemy.orm import InstrumentedAttribute, Session

from server.models import AccidentClaim, Alert, AlertChannel, Analysis, Erasure, Rerun, RetentionRule, TheftWatch

_NAMED: tuple[tuple[InstrumentedAttribute[Any], Any], ...] = (
    (Alert.acknowledged_by, Alert),
    (TheftWatch.armed_by, TheftWatch),
    (AccidentClaim.created_by, AccidentClaim),
    (RetentionRule.updated_by, RetentionRule),
    (Rerun.created_by, Rerun),
    (Analysis.creator, Analysis),
)
"""A column that says who did something, and its table."""


def mentions(session: Session, organisation_id: str, email: str) -> dict[str, int]:
    """How often an e-mail stands where it does not stay, and how many channels send alerts to it."""
    counts = [
        session.scalar(
            select(func.count()).select_from(table).where(table.organisation_id == organisation_id, column == email)
        )
        for column, table in _NAMED
    ]
    return {
        "names": sum(count or 0 for count in counts),
        "alert recipients": len(_sending(session, organisation_id, email)),
    }


def orders(session: Session, organisation_id: str, email: str) -> int:
    """Erasures that somebody ordered: their certificates say by whom."""
    query = select(func.count(Erasure.id)).where(Erasure.organisation_id == organisation_id)
    return session.scalar(query.where(Erasure.requested_by == email)) or 0


def forget(session: Session, organisation_id: str, email: str, *, instead: str) -> None:
    """Put another name in place of an e-mail, and send no alerts to it any more."""
    for column, table in _NAMED:
        named = table.organisation_id == organisation_id, column == email
        session.execute(update(table).where(*named).values({column.key: instead}))
    for channel in _sending(session, organisation_id, email):
        channel.recipients = [address for address in channel.recipients if str(address).lower() != email]
        # Nobody is left whom it could tell: it waits, switched off, for somebody to name.
        channel.enabled = channel.enabled and bool(channel.recipients)


def _sending(session: Session, organisation_id: str, email: str) -> list[AlertChannel]:
    mails = select(AlertChannel).where(AlertChannel.organisation_id == organisation_id, AlertChannel.kind == "email")
    return [row for row in session.scalars(mails) if email in {str(address).lower() for address in row.recipients}]
