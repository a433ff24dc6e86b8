"""Sending an alert as e-mail through the operator's server."""

from __future__ import annotations

import datetime as dt
import smtplib
import socket
import ssl
import threading
from collections.abc import Sequence
from email.message import EmailMessage
from email.utils import format_datetime

from server.alerts.webhook import Answer
from server.settings import Settings

TOTAL_S = 30.0
STEP_S = 10.0
_PERMANENT = 500


def message_of(
    sender: str, recipients: Sequence[str], subject: str, text: str, *, delivery_id: str, at: dt.datetime, urgent: bool
) -> EmailMessage:
    """A plain message; its Message-ID is the delivery's, so that a mail that comes twice is known as one."""
    message = EmailMessage()
    message["From"], message["To"] = sender, ", ".join(recipients)
    message["Subject"] = " ".join(subject.split())[:200]  # names come from people and may hold line breaks
    message["Date"] = format_datetime(at)
    message["Message-ID"] = f"<{delivery_id}@{sender.rpartition('@')[2] or 'localhost'}>"
    message["Auto-Submitted"] = "auto-generated"
    if urgent:
        message["Importance"], message["X-Priority"] = "high", "1"
    message.set_content(text)
    return message


def send(settings: Settings, message: EmailMessage) -> Answer:
    """Hand a message over to the server once."""
    if settings.smtp_host is None:
        return Answer(delivered=False, status=None, detail="SCATOLA_SMTP_HOST is not set")
    try:
        return _send(settings, settings.smtp_host, message)
    except smtplib.SMTPRecipientsRefused as error:
        codes = {code for code, _ in error.recipients.values()}
        final = all(code >= _PERMANENT for code in codes)
        return Answer(
            delivered=False, status=max(codes), detail=f"recipients refused: {_words(error.recipients)}", final=final
        )
    except smtplib.SMTPResponseException as error:
        detail = f"{type(error).__name__}: {error.smtp_code} {_text(error.smtp_error)}"[:400]
        return Answer(delivered=False, status=error.smtp_code, detail=detail)
    except (OSError, smtplib.SMTPException, ValueError) as error:
        return Answer(delivered=False, status=None, detail=f"{type(error).__name__}: {error}"[:400])


def _send(settings: Settings, host: str, message: EmailMessage) -> Answer:
    ca_file = None if settings.alert_ca_file is None else str(settings.alert_ca_file)
    context = ssl.create_default_context(cafile=ca_file)
    if settings.smtp_security == "tls":
        server: smtplib.SMTP = smtplib.SMTP_SSL(host, settings.smtp_port, timeout=STEP_S, context=context)
    else:
        server = smtplib.SMTP(host, settings.smtp_port, timeout=STEP_S)
    watch = threading.Timer(TOTAL_S, lambda: _cut(server))
    watch.daemon = True
    watch.start()
    try:
        if settings.smtp_security == "starttls":
            server.starttls(context=context)  # raises where the server does not offer it: never in the clear
        if settings.smtp_user is not None and settings.smtp_password is not None:
            server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
        refused = server.send_message(message)
    finally:
        watch.cancel()
        _leave(server)
    return Answer(delivered=True, status=250, detail=f"refused for some: {_words(refused)}"[:400] if refused else "")


def _leave(server: smtplib.SMTP) -> None:
    """Say good-bye; what was accepted stays accepted whatever comes of it."""
    try:
        server.quit()
    except (OSError, smtplib.SMTPException):
        server.close()


def _cut(server: smtplib.SMTP) -> None:
    try:
        if server.sock is not None:
            server.sock.shutdown(socket.SHUT_RDWR)
    except OSError:
        return


def _words(refused: dict[str, tuple[int, bytes]]) -> str:
    return "; ".join(f"{who}: {code} {_text(why)}" for who, (code, why) in refused.items())[:350]


def _text(words: bytes | str) -> str:
    return words.decode("utf-8", "replace") if isinstance(words, bytes) else words
