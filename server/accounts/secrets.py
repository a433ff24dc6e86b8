"""Tokens and their hashes.

Every token is drawn with 128 bits or more, so a plain SHA-256 is enough: there is nothing to guess
that a slow hash would make slower, and a lookup by hash needs no comparison in our code.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets

KEY_PREFIX = "sck_"
"""Begins every API key: lets scanners find one that leaked, and the gate know one."""


def new_token(prefix: str = "") -> str:
    """A fresh 256-bit token, URL-safe."""
    return prefix + secrets.token_urlsafe(32)


def new_code() -> str:
    """A fresh 128-bit code that people copy by hand if they must."""
    return secrets.token_urlsafe(16)


def hash_of(token: str) -> str:
    """What is stored of a token, 64 hexadecimal digits."""
    return hashlib.sha256(token.encode()).hexdigest()


def same(given: str, expected: str) -> bool:
    """Whether two secrets agree, in a time that tells nothing; an operator's secret may be short."""
    return hmac.compare_digest(hash_of(given), hash_of(expected))
