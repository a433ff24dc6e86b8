"""Passwords with argon2id and codes of an authenticator."""

from __future__ import annotations

import datetime as dt
import hmac
import threading

import pyotp
from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from pyotp.totp import TOTP

from server.errors import InvalidError

MIN_LENGTH, MAX_LENGTH = 12, 200
# RFC 9106's second profile, the library's default: 64 MiB for each.  No more than two at once, so that a crowd
# at the door does not fill the memory.
_HASHER = PasswordHasher()
_SLOTS = threading.BoundedSemaphore(2)
_STEP_S = 30


def check_new(password: str, email: str) -> None:
    """Raise unless a password is worth having: long, and not the e-mail's name."""
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        raise InvalidError(f"A password has {MIN_LENGTH} to {MAX_LENGTH} characters", code="password")
    plain = password.lower()
    if len(set(plain)) < 5 or plain in (email, email.partition("@")[0]):
        raise InvalidError("That password is guessed at once", code="password")


def hashed(password: str) -> str:
    """What is stored of a password."""
    with _SLOTS:
        return _HASHER.hash(password)


def matches(password_hash: str | None, password: str) -> bool:
    """Whether a password is the right one; takes as long where there is none to compare with."""
    with _SLOTS:
        try:
            return _HASHER.verify(password_hash or _NOBODY, password) and password_hash is not None
        except (VerificationError, InvalidHashError):
            return False


_NOBODY = _HASHER.hash("nobody has this password")


def new_totp_secret() -> str:
    """A secret for an authenticator, 160 bits in base32."""
    return pyotp.random_base32()


def totp_uri(secret: str, email: str) -> str:
    """What an authenticator reads."""
    return TOTP(secret).provisioning_uri(name=email, issuer_name="Scatola")


def totp_step(secret: str, code: str, *, after: int, now: dt.datetime) -> int | None:
    """The step whose code this is, of now and its neighbours, and later than `after`; None when it is none."""
    current = int(now.timestamp()) // _STEP_S
    totp = TOTP(secret)
    for step in (current, current - 1, current + 1):
        if step > after and hmac.compare_digest(totp.at(step * _STEP_S).encode(), code.strip().encode()):
            return step
    return None
