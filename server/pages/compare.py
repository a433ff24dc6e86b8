"""Two revisions of an event side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import orjson
from sqlalchemy.orm import Session

from server.events import queries
from server.events.service import differences
from server.models import EventRevision
from server.pages.events import Line, line_of
from server.reports.figures import in_unit, number_rows
from server.reports.words import Words


@dataclass(frozen=True)
class Comparison:
    """Two revisions of an event side by side."""

    line: Line
    before: EventRevision
    after: EventRevision
    figures: Sequence[tuple[str, str, str, str, str, str]]
    """Name, value and interval before, value and interval after, unit; those that changed come first."""
    changed: int
    """How many of the figures changed."""
    members: Sequence[tuple[str, str, str]]
    """Members of the canonical JSON that differ."""

    @property
    def same_input(self) -> bool:
        return self.before.input_sha256 == self.after.input_sha256

    @property
    def same_algorithm(self) -> bool:
        return self.before.algorithm == self.after.algorithm


def comparison(
    session: Session, organisation_id: str, event_id: str, before: int, after: int, words: Words, per_kmh: float
) -> Comparison:
    """What a revision says otherwise than one before it."""
    event = queries.event_of(session, organisation_id, event_id)
    old, new = (queries.revision_of(session, event, number) for number in (before, after))
    documents = queries.document(old), queries.document(new)
    rows = [{row[0]: row for row in number_rows(in_unit(each["event"], per_kmh), words)} for each in documents]
    nothing = ("", "\N{EN DASH}", "\N{EN DASH}", "")
    pairs = [(name, rows[0].get(name, nothing), rows[1].get(name, nothing)) for name in {**rows[0], **rows[1]}]
    pairs.sort(key=lambda pair: pair[1] == pair[2])
    return Comparison(
        line_of(session, event),
        old,
        new,
        [(name, a[1], a[2], b[1], b[2], b[3] or a[3]) for name, a, b in pairs],
        sum(a != b for _, a, b in pairs),
        [(path, _told(a), _told(b)) for path, a, b in differences(*documents)],
    )


def _told(value: Any) -> str:
    text = orjson.dumps(value).decode()
    return text if len(text) <= 120 else text[:119] + "\N{HORIZONTAL ELLIPSIS}"
