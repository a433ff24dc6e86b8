"""Paying what the outbox owes: each message at least once, each try on record.

A delivery is taken by moving its due time on by a lease and writing the try, in one transaction; then it is sent; then
what came of it is written.  Whoever dies in between leaves a lease that runs out, and the message goes again under the
same id, by which the receiver knows it.
"""

from __future__ import annotations

import datetime as dt
import random
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import structlog
from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session

from server.accounts.preferences import LANGUAGES, Language, Preferences
from server.alerts import mail, webhook, words
from server.alerts.raising import EMERGENCY, ORDINARY
from server.alerts.webhook import Answer, Guard
from server.database import Database
from server.language import catalogue
from server.live.changes import announce
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, DeliveryAttempt, Device, User, Vehicle, new_id
from server.moments import Clock
from server.settings import Settings

LEASE = dt.timedelta(seconds=60)
"""Longer than any try may take."""
BACKOFF_S = {EMERGENCY: (2.0, 120.0), ORDINARY: (10.0, 3600.0)}
"""Pause after the first failure, and at most; it doubles each time."""
LOOK_S = 0.5
EMERGENCY_SENDERS, ORDINARY_SENDERS = 2, 4
"""One receiver that takes its ten seconds each time does not hold up the others."""

log = structlog.stdlib.get_logger("scatola.alerts")


@dataclass(frozen=True)
class Taken:
    """A delivery in hand: what to send, and where."""

    delivery_id: str
    number: int
    attempt_id: str
    urgent: bool
    body: bytes
    subject: str
    channel: AlertChannel | None


def deliver_due(
    database: Database, settings: Settings, *, clock: Clock, priorities: Sequence[int] = (EMERGENCY, ORDINARY)
) -> int:
    """Try everything that is due; how many tries were made."""
    tries = 0
    while (taken := _take(database, settings, clock(), priorities)) is not None:
        answer = _send(settings, taken, clock())
        _conclude(database, settings, taken, answer, clock())
        tries += 1
    return tries


def pause_s(priority: int, failures: int, chance: float) -> float:
    """How long to wait after so many failures; `chance` in [0, 1) spreads those that failed together."""
    first, most = BACKOFF_S[priority]
    return min(first * 2.0 ** min(failures - 1, 30), most) * (0.5 + chance)


def _due(now: dt.datetime, priorities: Sequence[int]) -> Select[AlertDelivery]:
    due = AlertDelivery.state == "waiting", AlertDelivery.due_at <= now, AlertDelivery.priority.in_(priorities)
    return select(AlertDelivery).where(*due).order_by(AlertDelivery.priority, AlertDelivery.due_at).limit(1)


def _take(database: Database, settings: Settings, now: dt.datetime, priorities: Sequence[int]) -> Taken | None:
    with database.transaction() as session:
        row = session.scalars(_due(now, priorities).with_for_update(skip_locked=True)).first()
        if row is None:
            return None
        row.due_at = now + LEASE
        row.attempts += 1
        subject = _subject(session, session.get_one(Alert, row.alert_id))
        channel = session.get(AlertChannel, row.channel_id)
        languages = languages_of(session, channel)
        if row.body is None:
            row.body = _body(subject, row, channel, settings.public_url, languages)
        tried = select(func.count()).select_from(DeliveryAttempt).where(DeliveryAttempt.delivery_id == row.id)
        attempt = DeliveryAttempt(
            id=new_id(),
            organisation_id=row.organisation_id,
            delivery_id=row.id,
            number=(session.scalar(tried) or 0) + 1,
            began_at=now,
        )
        session.add(attempt)
        title = " / ".join(words.title(subject, row.reason, _say(language)) for language in languages)
        urgent = row.priority == EMERGENCY
        return Taken(row.id, row.attempts, attempt.id, urgent, row.body, title, channel)


def _subject(session: Session, alert: Alert) -> words.Subject:
    return words.Subject(
        alert,
        session.get(AlertRule, alert.rule_id) if alert.rule_id else None,
        session.get_one(Device, alert.device_id),
        session.get(Vehicle, alert.vehicle_id) if alert.vehicle_id else None,
    )


def languages_of(session: Session, channel: AlertChannel | None) -> list[Language]:
    """What those read who get a mail; who has no account here, or chose nothing, reads English."""
    if channel is None or channel.kind != "email":
        return ["en"]
    addresses = {str(address).lower() for address in channel.recipients}
    accounts = select(User.email, User.preferences).where(
        User.organisation_id == channel.organisation_id, User.email.in_(addresses)
    )
    chosen = {email: Preferences.from_json(kept).language for email, kept in session.execute(accounts)}
    read = {chosen.get(address) or "en" for address in addresses}
    return [language for language in LANGUAGES if language in read]


def _say(language: Language) -> words.Say:
    return words.english if language == "en" else catalogue(language).gettext


def _body(
    subject: words.Subject,
    row: AlertDelivery,
    channel: AlertChannel | None,
    public_url: str | None,
    languages: Sequence[Language],
) -> bytes:
    if channel is None or channel.kind != "email":
        return words.document(subject, row, public_url)
    # One mail to all of them: whoever shares it finds his own language below the other.
    return "\n".join(words.mail_text(subject, row, public_url, _say(language)) for language in languages).encode()


def _send(settings: Settings, taken: Taken, now: dt.datetime) -> Answer:
    """Try once; whatever goes wrong is an answer, for the try must be concluded."""
    channel = taken.channel
    if channel is None or not channel.enabled:
        return Answer(delivered=False, status=None, detail="the channel was deleted or is off", final=True)
    try:
        if channel.kind == "email":
            message = mail.message_of(
                settings.smtp_sender,
                channel.recipients,
                taken.subject,
                taken.body.decode(),
                delivery_id=taken.delivery_id,
                at=now,
                urgent=taken.urgent,
            )
            return mail.send(settings, message)
        return _post(settings, channel, taken, now)
    except Exception as error:
        log.exception("delivery failed", delivery_id=taken.delivery_id)
        return Answer(delivered=False, status=None, detail=type(error).__name__)


def send_test(
    settings: Settings, channel: AlertChannel, *, now: dt.datetime, languages: Sequence[Language] = ("en",)
) -> Answer:
    """Try a channel once, with a message that says so; it is owed to nobody and is not tried again."""
    delivery_id = new_id()
    title = " / ".join(_say(language)(words.TEST_SUBJECT) for language in languages)
    text = "\n".join(_say(language)(words.TEST_TEXT) + "\n" for language in languages)
    body = text.encode() if channel.kind == "email" else words.tried_document(delivery_id)
    return _send(settings, Taken(delivery_id, 1, "", False, body, title, channel), now)


def _post(settings: Settings, channel: AlertChannel, taken: Taken, now: dt.datetime) -> Answer:
    timestamp = int(now.timestamp())
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "Scatola",
        "Idempotency-Key": taken.delivery_id,
        "Scatola-Attempt": str(taken.number),
        "Scatola-Timestamp": str(timestamp),
        "Scatola-Signature": webhook.signature(channel.secret or "", timestamp, taken.body),
    }
    guard = Guard(settings.webhook_networks)
    return webhook.post(channel.recipients[0], taken.body, headers, guard=guard, ca_file=settings.alert_ca_file)


def _conclude(database: Database, settings: Settings, taken: Taken, answer: Answer, now: dt.datetime) -> None:
    with database.transaction() as session:
        row = session.get(AlertDelivery, taken.delivery_id, with_for_update=True)
        attempt = session.get(DeliveryAttempt, taken.attempt_id)
        if row is None or attempt is None:
            return  # erased meanwhile
        attempt.ended_at, attempt.status, attempt.detail = now, answer.status, answer.detail or None
        attempt.outcome = "delivered" if answer.delivered else "failed"
        if row.state != "waiting":
            return
        if answer.delivered:
            row.state, row.finished_at, row.error = "delivered", now, None
        elif row.attempts != taken.number:
            return  # the lease ran out and another took it: that one's outcome counts
        else:
            row.error = answer.detail[:500]
            if answer.final or row.attempts >= settings.alert_attempts:
                row.state, row.finished_at = "dead", now
                log.warning("delivery is dead", delivery_id=row.id, attempts=row.attempts, status=answer.status)
            else:
                chance = random.random()  # noqa: S311  spreads retries, protects nothing
                row.due_at = now + dt.timedelta(seconds=pause_s(row.priority, row.attempts, chance))
                return
        announce(session, "alert", at=now, organisation_id=row.organisation_id, data={"alert_id": row.alert_id})


def start(database: Database, settings: Settings, *, stop: threading.Event, clock: Clock) -> list[threading.Thread]:
    """Send in the background: emergencies from threads of their own, which no slow receiver of the rest holds up."""

    def senders(name: str, priority: int, count: int) -> list[threading.Thread]:
        due = partial(_any_due, database, clock, priority)
        work = partial(deliver_due, database, settings, clock=clock, priorities=(priority,))
        run = partial(_send_what_is_due, name, due, work, threading.Lock(), stop)
        return [threading.Thread(target=run, name=name, daemon=True) for _ in range(count)]

    threads = senders("emergencies", EMERGENCY, EMERGENCY_SENDERS) + senders("deliveries", ORDINARY, ORDINARY_SENDERS)
    for thread in threads:
        thread.start()
    return threads


def _any_due(database: Database, clock: Clock, priority: int) -> bool:
    with database.reading() as session:  # without a lock on anything
        return session.scalars(_due(clock(), (priority,))).first() is not None


def _send_what_is_due(
    name: str, due: Callable[[], bool], work: Callable[[], int], turn: threading.Lock, stop: threading.Event
) -> None:
    """Be one of the senders that share `turn`: of those at leisure one looks for all, the rest cost nothing.

    Who finds something leaves the looking to the next one before it sends, so that a slow receiver holds up
    nobody; that one looks at once, for where one thing is due there may be more.
    """
    while not stop.is_set():
        found = False
        try:
            with turn:
                while not stop.is_set() and not (found := due()):
                    stop.wait(LOOK_S)
            if found:
                work()
        except Exception:
            log.exception("deliveries cannot be made", sender=name)
            stop.wait(LOOK_S)
