"""A large body, read as it comes and no further than its limit."""

from __future__ import annotations

import asyncio

from fastapi import Request
from starlette.requests import ClientDisconnect

from server.errors import SlowBodyError, TooLargeError

# A box on a bad link is slow, but one that stops in the middle must not hold a connection for ever.
BODY_TIMEOUT_S = 120.0


async def read_body(request: Request, max_bytes: int) -> bytes:
    """The body; TooLargeError beyond the limit, SlowBodyError where it does not arrive."""
    announced = request.headers.get("content-length", "")
    if announced.isdecimal() and int(announced) > max_bytes:
        raise TooLargeError(f"The body is larger than {max_bytes} bytes")
    body = bytearray()
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            async for chunk in request.stream():
                body += chunk
                if len(body) > max_bytes:
                    raise TooLargeError(f"The body is larger than {max_bytes} bytes")
    except TimeoutError:
        raise SlowBodyError(f"The body did not arrive within {BODY_TIMEOUT_S:g} s") from None
    except ClientDisconnect:
        raise SlowBodyError("The connection ended within the body") from None
    return bytes(body)
