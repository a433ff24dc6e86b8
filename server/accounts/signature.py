"""Signed requests: the box shows that it knows its token without sending it.

The key is the token's hash, which is what the service stores.  There is no nonce: the signature names the batch it
belongs to, and a batch is stored once; what is older than the window is refused (docs/adr/0016).
"""

from __future__ import annotations

import datetime as dt
import hashlib
import hmac
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from server.errors import UnauthenticatedError

SCHEME = "scatola-hmac-sha256"
WINDOW_S = 300.0
SIGNED_HEADERS = (
    "idempotency-key",
    "scatola-stream",
    "scatola-sent-at",
    "scatola-configuration",
    "scatola-answers",
    "content-type",
    "content-encoding",
)
"""All that says something of an upload: `scatola-sent-at` alone can date a batch."""
_FORM = re.compile(
    r"device=(?P<device>[0-9a-f]{32}),\s*time=(?P<time>\d{1,12}),\s*"
    r"body=(?P<body>[0-9a-f]{64}),\s*signature=(?P<signature>[0-9a-f]{64})"
)


@dataclass(frozen=True, slots=True)
class Claim:
    """What a signed request says of itself, before anything is believed."""

    device_id: str
    time_s: int
    body_sha256: str
    signature: str


def parse(credentials: str) -> Claim:
    """The parts behind the scheme of an Authorization header."""
    match = _FORM.fullmatch(credentials.strip())
    if match is None:
        raise UnauthenticatedError("Sign as device=..., time=..., body=..., signature=...", code="signature")
    return Claim(match["device"], int(match["time"]), match["body"], match["signature"])


def sign(
    token_sha256: str, *, method: str, path: str, device_id: str, time_s: int, headers: Mapping[str, str], body: bytes
) -> str:
    """Value of the Authorization header; `headers` by lower-case names."""
    claim = Claim(device_id, time_s, hashlib.sha256(body).hexdigest(), "")
    signature = _signature(token_sha256, method, path, claim, headers)
    return f"Scatola-HMAC-SHA256 device={device_id}, time={time_s}, body={claim.body_sha256}, signature={signature}"


def _signature(token_sha256: str, method: str, path: str, claim: Claim, headers: Mapping[str, str]) -> str:
    lines = ["scatola-request-1", method, path, claim.device_id, str(claim.time_s)]
    lines += [headers.get(name, "") for name in SIGNED_HEADERS] + [claim.body_sha256]
    return hmac.new(bytes.fromhex(token_sha256), "\n".join(lines).encode(), "sha256").hexdigest()


def check(
    claim: Claim, keys: Sequence[str], *, method: str, path: str, headers: Mapping[str, str], now: dt.datetime
) -> str:
    """The box's key that signed; raises unless one did, and lately.  A box whose clock is off is told the time."""
    made = {key: _signature(key, method, path, claim, headers) for key in keys}
    key = next((key for key, signature in made.items() if hmac.compare_digest(signature, claim.signature)), None)
    if key is None:
        raise UnauthenticatedError("The signature is not this box's for this request", code="signature")
    if abs(now.timestamp() - claim.time_s) > WINDOW_S:
        raise UnauthenticatedError(
            f"Signed at another time than {WINDOW_S:g} s around now; correct the clock by server_time",
            code="clock_skew",
            server_time=now.isoformat(),
        )
    return key
