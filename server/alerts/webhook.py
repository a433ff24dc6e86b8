"""Posting to an address that a customer typed in: signed, bounded in time and size, and never into our own network.

The name is resolved once and the connection goes to the very address that was checked, so a name that
changes its mind between check and use (DNS rebinding) gains nothing.  Redirects are not followed and no
proxy from the environment is used, for the same reason.
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import ipaddress
import socket
import ssl
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from server.errors import InvalidError

TOTAL_S = 10.0
"""From the first byte of the name to the last of the answer."""
CONNECT_S = 5.0
MAX_ANSWER_BYTES = 64 * 1024
MAX_URL = 2000
_GONE = 410

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Resolve = Callable[[str, int], Sequence[str]]
_NAT64 = ipaddress.ip_network("64:ff9b::/96")
_LOCAL_NAT64 = ipaddress.ip_network("64:ff9b:1::/48")


class RefusedTargetError(Exception):
    """The address is one that must not be spoken to."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a post."""

    delivered: bool
    status: int | None
    detail: str
    final: bool = False
    """Whether trying again is pointless."""


@dataclass(frozen=True, slots=True)
class Guard:
    """Which addresses may be spoken to."""

    networks: tuple[str, ...] = ()
    """The operator's own, where private addresses and plain http are allowed."""

    def allows_plain(self, address: str) -> bool:
        """Whether the operator named the address' network."""
        found = _real(ipaddress.ip_address(address))
        return any(found in ipaddress.ip_network(network) for network in self.networks)

    def check(self, address: str) -> None:
        """Raise unless an address may be spoken to."""
        found = _real(ipaddress.ip_address(address.partition("%")[0]))
        if self.allows_plain(str(found)):
            return
        if not found.is_global or found.is_multicast or found.is_reserved or found.is_unspecified:
            raise RefusedTargetError(f"{found} is not a public address")


def _real(address: Address) -> Address:
    """The address that is really reached, where one hides inside another."""
    if isinstance(address, ipaddress.IPv4Address):
        return address
    hidden = address.ipv4_mapped or address.sixtofour
    if hidden is None and address.teredo is not None:
        hidden = address.teredo[1]
    if hidden is None and (address in _NAT64 or address in _LOCAL_NAT64):
        hidden = ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return address if hidden is None else hidden


def check_url(url: str, guard: Guard) -> None:
    """Raise unless a webhook may have this address; what its name stands for is looked at with every post."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise InvalidError("The webhook's address is not one", code="webhook_url") from None
    if len(url) > MAX_URL or not url.isascii() or any(letter <= " " for letter in url):
        raise InvalidError(f"A webhook's address is ASCII, at most {MAX_URL} letters", code="webhook_url")
    plain = parts.scheme == "http" and bool(guard.networks)
    if not (parts.scheme == "https" or plain) or not parts.hostname or parts.username is not None or port == 0:
        raise InvalidError("A webhook's address is https://host/..., without a user in it", code="webhook_url")
    try:
        guard.check(parts.hostname)
    except RefusedTargetError as error:
        raise InvalidError(f"The webhook's address is refused: {error}", code="webhook_target") from None
    except ValueError:
        return  # a name, not an address


def signature(secret: str, timestamp: int, body: bytes) -> str:
    """``v1=`` and the HMAC-SHA256 of ``timestamp.body``; the time keeps an old post from being played again."""
    signed = f"{timestamp}.".encode() + body
    return "v1=" + hmac.new(secret.encode(), signed, hashlib.sha256).hexdigest()


def resolve(host: str, port: int) -> list[str]:
    """All addresses of a name."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))


def post(
    url: str,
    body: bytes,
    headers: dict[str, str],
    *,
    guard: Guard,
    ca_file: Path | None = None,
    total_s: float = TOTAL_S,
    resolver: Resolve = resolve,
) -> Answer:
    """Post once."""
    parts = urlsplit(url)
    host, secure = parts.hostname or "", parts.scheme == "https"
    port = parts.port or (443 if secure else 80)
    try:
        address = _checked(resolver(host, port), guard, secure=secure)
    except RefusedTargetError as error:
        return Answer(delivered=False, status=None, detail=f"refused: {error}")
    except OSError as error:
        return Answer(delivered=False, status=None, detail=f"the name cannot be resolved: {error}")
    connection = http.client.HTTPConnection(host, port, timeout=CONNECT_S)
    # A receiver that sends a byte a second would outlast any timeout of single reads.
    late = threading.Event()
    watch = threading.Timer(total_s, lambda: _cut(connection, late))
    watch.daemon = True
    try:
        sock = socket.create_connection((address, port), timeout=min(CONNECT_S, total_s))
        connection.sock = sock
        watch.start()
        if secure:
            context = ssl.create_default_context(cafile=None if ca_file is None else str(ca_file))
            connection.sock = context.wrap_socket(sock, server_hostname=host)
        connection.sock.settimeout(total_s)
        connection.request("POST", _path(parts), body, {"Host": _host(parts, host), **headers})
        answer = connection.getresponse()
        answer.read(MAX_ANSWER_BYTES)
        if late.is_set():
            raise TimeoutError(f"the answer was not whole within {total_s:g} s")
    except (OSError, http.client.HTTPException, ValueError) as error:
        return Answer(delivered=False, status=None, detail=f"{type(error).__name__}: {error}"[:400])
    finally:
        watch.cancel()
        connection.close()
    delivered = 200 <= answer.status < 300
    detail = "" if delivered else f"the receiver answered {answer.status} {answer.reason}"[:400]
    return Answer(delivered, answer.status, detail, final=answer.status == _GONE)


def _checked(addresses: Sequence[str], guard: Guard, *, secure: bool) -> str:
    """The address to connect to; one bad among them spoils the name."""
    for address in addresses:
        guard.check(address)
        if not secure and not guard.allows_plain(address):
            raise RefusedTargetError(f"plain http to {address}")
    if not addresses:
        raise RefusedTargetError("the name has no address")
    return addresses[0]


def _path(parts: SplitResult) -> str:
    return (parts.path or "/") + (f"?{parts.query}" if parts.query else "")


def _host(parts: SplitResult, host: str) -> str:
    name = f"[{host}]" if ":" in host else host
    return name if parts.port is None else f"{name}:{parts.port}"


def _cut(connection: http.client.HTTPConnection, late: threading.Event) -> None:
    late.set()
    try:
        if connection.sock is not None:
            connection.sock.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # it ended by itself meanwhile
