"""What somebody wants to read the pages in; kept with the account, or with the session of whoever has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, cast, get_args

Language = Literal["en", "it"]
Units = Literal["metric", "imperial"]

LANGUAGES: dict[Language, str] = {"en": "English", "it": "Italiano"}
"""Each in its own words."""
MAX_VIEWS = 30


@dataclass(frozen=True)
class View:
    """A list as somebody wants to see it again: its page, and the filters of its address."""

    page: str
    name: str
    query: str


@dataclass(frozen=True)
class Preferences:
    """Nothing chosen: the browser's language, and metres."""

    language: Language | None = None
    units: Units = "metric"
    views: tuple[View, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Plain document for the database."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: Mapping[str, Any] | None) -> Preferences:
        """Preferences from what `to_json` gave, whatever version wrote it."""
        document = document or {}
        language, units = document.get("language"), document.get("units")
        return cls(
            language=language if language in LANGUAGES else None,
            units=cast("Units", units) if units in get_args(Units) else "metric",
            views=tuple(View(view["page"], view["name"], view["query"]) for view in document.get("views", ())),
        )

    def with_view(self, view: View) -> Preferences:
        """Also this one; the same name on the same page is replaced."""
        kept = self.without_view(view.page, view.name).views
        return Preferences(self.language, self.units, (*kept, view)[-MAX_VIEWS:])

    def without_view(self, page: str, name: str) -> Preferences:
        """All but this one."""
        kept = tuple(view for view in self.views if (view.page, view.name) != (page, name))
        return Preferences(self.language, self.units, kept)

    def views_of(self, page: str) -> list[View]:
        """The views of one list."""
        return [view for view in self.views if view.page == page]


def preferred(accept_language: str) -> Language:
    """The language of ours that a browser asks for first; English where it asks for none."""
    wanted: list[tuple[float, int, Language]] = []
    for place, part in enumerate(accept_language.split(",")[:20]):
        tag, _, parameter = part.strip().partition(";")
        name = tag.strip().lower().split("-")[0]
        try:
            weight = float(parameter.strip().removeprefix("q=") or 1.0)
        except ValueError:
            continue
        if name in LANGUAGES and weight > 0.0:
            wanted.append((-weight, place, name))
    return min(wanted)[2] if wanted else "en"
