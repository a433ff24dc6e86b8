"""What stands around every page: its sections, and the words and units of whoever reads it."""

from __future__ import annotations

from dataclasses import dataclass

from starlette.requests import HTTPConnection

from server.accounts.caller import Caller
from server.accounts.permissions import Permission
from server.accounts.preferences import Language, Preferences, Units, preferred
from server.wording import marked


@dataclass(frozen=True)
class Section:
    """An entry of the rail; a phone's bar has the first `ON_PHONE` that somebody may see, the rest under "More"."""

    key: str
    href: str
    icon: str
    words: str
    permission: Permission = "fleet.read"


SECTIONS = (
    Section("fleet", "/", "map", marked("Fleet")),
    Section("vehicles", "/vehicles", "car", marked("Vehicles")),
    Section("events", "/events", "impact", marked("Events")),
    Section("install", "/install", "wrench", marked("Install"), "install"),
    Section("trips", "/trips", "way", marked("Trips")),
    Section("alerts", "/alerts", "bell", marked("Alerts")),
    Section("workbench", "/workbench", "bench", marked("Workbench"), "raw.read"),
    Section("admin", "/admin", "gear", marked("Administration"), "fleet.write"),
)
ADMINISTRATION = (
    Section("overview", "/admin", "list", marked("Overview"), "fleet.write"),
    Section("boxes", "/admin/boxes", "box", marked("Boxes"), "fleet.write"),
    Section("rules", "/admin/alerts", "bell", marked("Rules and channels"), "fleet.write"),
    Section("work", "/admin/work", "list", marked("Work"), "jobs.manage"),
    Section("versions", "/admin/versions", "list", marked("Versions"), "jobs.manage"),
    Section("users", "/users", "people", marked("People"), "users.manage"),
    Section("privacy", "/privacy", "shield", marked("Privacy"), "privacy.manage"),
    Section("audit", "/audit", "list", marked("Audit"), "audit.read"),
)
"""The pages of the last section; each shows the others above it."""
ON_PHONE = 3


@dataclass(frozen=True)
class Measures:
    """Units of length and speed as they are shown; everything else is the same everywhere."""

    speed: str
    per_mps: float
    distance: str
    per_m: float


MEASURES: dict[Units, Measures] = {
    "metric": Measures("km/h", 3.6, "km", 1e-3),
    "imperial": Measures("mph", 3600.0 / 1609.344, "mi", 1.0 / 1609.344),
}


def sections(caller: Caller) -> list[Section]:
    """The sections that the caller may see; who installs and does not manage has the assistant first."""
    seen = [section for section in SECTIONS if caller.may(section.permission)]
    if caller.may("install") and not caller.may("fleet.write"):
        seen.sort(key=lambda section: section.key != "install")
    return seen


def administration(caller: Caller) -> list[Section]:
    """The administration's pages that the caller may see."""
    return [page for page in ADMINISTRATION if caller.may(page.permission)]


def preferences_of(connection: HTTPConnection) -> Preferences:
    """What the caller chose; nothing where nobody is signed in."""
    caller: Caller | None = getattr(connection.state, "caller", None)
    return Preferences() if caller is None else caller.preferences


def measures_of(connection: HTTPConnection) -> Measures:
    """The units that the account says."""
    return MEASURES[preferences_of(connection).units]


def language_of(connection: HTTPConnection) -> Language:
    """The language that the account says, else the browser's."""
    return preferences_of(connection).language or preferred(connection.headers.get("accept-language", ""))
