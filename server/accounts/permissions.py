"""What somebody may do, and which of it each role has."""

from __future__ import annotations

from typing import Literal, get_args

Permission = Literal[
    "fleet.read",  # vehicles, boxes, mountings, trips as figures
    "fleet.write",  # register, swap, revoke, configure
    "install",  # mountings by hand, claim codes, which vehicle a box sits in
    "location.read",  # where a vehicle is or was
    "location.coarse",  # the same to about a kilometre (`server.accounts.places`)
    "raw.read",  # the samples themselves
    "events.review",  # say what an event was, order and end legal holds
    "users.manage",  # people, API keys
    "audit.read",  # who did and saw what
    "privacy.manage",  # how long data are kept, what is erased
    "privacy.export",  # everything that is held about a vehicle or a user, in one file
    "export",  # tracks, events and samples of many vehicles at once
    "jobs.manage",  # work that keeps failing, re-runs by another version
]
PERMISSIONS: tuple[Permission, ...] = get_args(Permission)
ALL: frozenset[Permission] = frozenset(PERMISSIONS)

ROLE_PERMISSIONS: dict[str, frozenset[Permission]] = {
    "admin": ALL,
    "manager": frozenset({"fleet.read", "fleet.write", "install", "location.read", "location.coarse"}),
    "installer": frozenset({"fleet.read", "install", "location.coarse"}),
    "claims": frozenset({"fleet.read", "location.read", "location.coarse", "raw.read", "events.review"}),
    "reader": frozenset({"fleet.read", "location.coarse"}),
}


def known(scopes: list[object]) -> frozenset[Permission]:
    """The permissions among some words; what this version does not know opens nothing."""
    return frozenset(permission for permission in PERMISSIONS if permission in scopes)
