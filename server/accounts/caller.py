"""Who is calling; known to services, which know nothing of the web framework."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from server.accounts.permissions import Permission
from server.accounts.preferences import Preferences


@dataclass(frozen=True, slots=True)
class Caller:
    """An authenticated caller.

    ``admin`` holds the administrator's token, ``session`` is a signed-in browser, ``key`` a program with an API
    key, ``device`` a box, ``ticket`` a view that was opened for one device, ``job`` the service itself or its operator
    at the command line, for the audit log.
    """

    organisation_id: str
    kind: Literal["admin", "session", "key", "device", "ticket", "job"]
    name: str = ""
    permissions: frozenset[Permission] = frozenset()
    user_id: str | None = None
    key_id: str | None = None
    session_id: str | None = None
    csrf_token: str | None = None
    device_id: str | None = None
    address: str = ""
    """Where the request came from, as far as the proxies in front are believed."""
    preferences: Preferences = field(default_factory=Preferences)
    signed_body_sha256: str | None = None
    """Of a signed request: the hash that its body, as sent, must have."""

    def may(self, permission: Permission) -> bool:
        """Whether the caller has a permission."""
        return permission in self.permissions
