"""Real receivers of alerts: a webhook over HTTP or HTTPS and an SMTP server, both on a free loopback port."""

from __future__ import annotations

import contextlib
import datetime as dt
import email
import email.policy
import http.server
import ipaddress
import socket
import socketserver
import ssl
import threading
from collections.abc import Generator
from dataclasses import dataclass, field
from email.message import EmailMessage
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID


@dataclass
class Post:
    path: str
    headers: dict[str, str]
    body: bytes


@dataclass
class Webhook:
    url: str
    posts: list[Post] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    """Answers to give, one after the other; 204 when none is left."""
    location: str | None = None
    trickle: bool = False
    """Answer a byte at a time, for ever."""
    hold: threading.Event | None = None
    """Wait for it before answering."""
    arrived: threading.Event = field(default_factory=threading.Event)


@contextlib.contextmanager
def webhook(certificate: tuple[Path, Path] | None = None) -> Generator[Webhook]:
    hook = Webhook("")
    over = threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            hook.posts.append(Post(self.path, dict(self.headers), body))
            hook.arrived.set()
            if hook.hold is not None:
                hook.hold.wait(30.0)
            if hook.trickle:
                with contextlib.suppress(OSError):
                    self.wfile.write(b"HTTP/1.1 200 OK\r\nX: ")
                    while not over.wait(0.05):
                        self.wfile.write(b"x")
                return
            self.send_response(hook.statuses.pop(0) if hook.statuses else 204)
            if hook.location:
                self.send_header("Location", hook.location)
            self.end_headers()

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    server.handle_error = lambda *_: None
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    hook.url = f"http{'s' if certificate else ''}://127.0.0.1:{server.server_address[1]}/hook?a=1"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield hook
    finally:
        over.set()
        server.shutdown()
        server.server_close()


@dataclass
class Mailbox:
    port: int
    mails: list[EmailMessage] = field(default_factory=list)
    envelopes: list[tuple[str, list[str]]] = field(default_factory=list)
    logins: list[str] = field(default_factory=list)
    refuse: set[str] = field(default_factory=set)
    """Recipients that do not exist."""
    failures: int = 0
    """So many sessions are turned away for now."""
    encrypted: list[bool] = field(default_factory=list)


@contextlib.contextmanager
def smtp_server(certificate: tuple[Path, Path] | None = None) -> Generator[Mailbox]:
    """As much of RFC 5321, 3207 and 4954 as a client that sends needs; STARTTLS where there is a certificate."""
    box = Mailbox(0)

    class Session(socketserver.BaseRequestHandler):
        def handle(self):
            self.stream, self.secure = self.request.makefile("rb"), False
            self.sender, self.recipients = "", []
            if box.failures > 0:
                box.failures -= 1
                self.say("421 come back later")
                return
            self.say("220 test")
            while line := self.stream.readline():
                if not self.obey(line.decode().strip()):
                    return

        def finish(self):
            self.stream.close()
            self.request.close()

        def say(self, *lines: str) -> None:
            self.request.sendall("".join(f"{line}\r\n" for line in lines).encode())

        def obey(self, line: str) -> bool:
            word = line.upper().partition(" ")[0]
            if word == "EHLO":
                more = [] if self.secure or certificate is None else ["250-STARTTLS"]
                self.say("250-test", *more, "250 AUTH PLAIN")
            elif word == "STARTTLS":
                self.say("220 go")
                context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
                context.load_cert_chain(*certificate)
                self.request = context.wrap_socket(self.request, server_side=True)
                self.stream, self.secure = self.request.makefile("rb"), True
            elif word == "AUTH":
                box.logins.append(line.rsplit(maxsplit=1)[-1])
                self.say("235 welcome")
            elif word == "MAIL":
                self.sender, self.recipients = line.partition("<")[2].partition(">")[0], []
                self.say("250 ok")
            elif word == "RCPT":
                who = line.partition("<")[2].partition(">")[0]
                self.recipients += [] if who in box.refuse else [who]
                self.say("550 nobody of that name" if who in box.refuse else "250 ok")
            elif word == "DATA":
                self.say("354 go on")
                body = b""
                while (row := self.stream.readline()) not in (b".\r\n", b""):
                    body += row[1:] if row.startswith(b"..") else row
                box.mails.append(email.message_from_bytes(body, policy=email.policy.default))
                box.envelopes.append((self.sender, self.recipients))
                box.encrypted.append(self.secure)
                self.say("250 taken")
            else:
                self.say("221 bye" if word == "QUIT" else "250 ok")
                return word != "QUIT"
            return True

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads, allow_reuse_address = True, True

        def handle_error(self, *_):
            pass

    server = Server(("127.0.0.1", 0), Session)
    box.port = server.server_address[1]
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
    try:
        yield box
    finally:
        server.shutdown()
        server.server_close()


def make_certificate(folder: Path) -> tuple[Path, Path]:
    """A self-signed certificate of 127.0.0.1, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "127.0.0.1")])
    now = dt.datetime.now(dt.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(days=1))
        .not_valid_after(now + dt.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1")), x509.DNSName("localhost")]),
            critical=False,
        )
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    files = folder / "cert.pem", folder / "key.pem"
    files[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    files[1].write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return files


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]
