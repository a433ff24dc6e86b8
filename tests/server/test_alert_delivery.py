"""The outbox: real receivers, retries, dead letters, replays, kills; and no way into one's own network."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime as dt
import hashlib
import hmac
import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from receivers import free_port, make_certificate, smtp_server, webhook
from sqlalchemy import select

from server.accounts.caller import Caller
from server.accounts.preferences import LANGUAGES, Preferences
from server.accounts.schemas import UserIn
from server.accounts.users import add_user
from server.alerts import delivery, service, words
from server.alerts.delivery import LEASE, deliver_due, pause_s
from server.alerts.raising import Finding, raise_all
from server.alerts.schemas import EmailIn, WebhookIn
from server.alerts.webhook import Answer, Guard, RefusedTargetError, check_url, post
from server.devices.schemas import DeviceIn
from server.devices.service import register
from server.errors import ConflictError, InvalidError
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, DeliveryAttempt, Device, Vehicle, new_id

both = pytest.mark.both_databases
LOOPBACK = ("127.0.0.0/8",)


@dataclasses.dataclass
class Outbox:
    """An organisation with a box; owes messages and pays them."""

    database: object
    settings: object
    clock: object
    organisation_id: str
    device_id: str

    def channel(self, wanted, networks=LOOPBACK):
        with self.database.transaction() as session:
            return service.add_channel(session, self.organisation_id, wanted, guard=Guard(networks), now=self.clock())

    def owe(self, *channels, kind="moved", facts=None, occurrence=None):
        with self.database.transaction() as session:
            rule = AlertRule(
                id=new_id(),
                organisation_id=self.organisation_id,
                name="rule",
                kind="moved",
                enabled=True,
                parameters={},
                channels=[channel.id for channel in channels],
                cooldown_s=0.0,
                created_at=self.clock(),
            )
            session.add(rule)
            finding = Finding(
                rule, kind, "attention", occurrence or new_id(), self.clock(), facts or {"angle_deg": 34.0}
            )
            raised = raise_all(session, self.organisation_id, self.device_id, None, [finding], now=self.clock())
            session.add_all(raised.alerts)
            session.flush()
            session.add_all(raised.deliveries)
            return [row.id for row in raised.deliveries]

    def pay(self, settings=None):
        return deliver_due(self.database, settings or self.settings, clock=self.clock)

    def rows(self, model, *order):
        with self.database.reading() as session:
            return list(session.scalars(select(model).order_by(*order)))

    def row(self, delivery_id):
        with self.database.reading() as session:
            return session.get_one(AlertDelivery, delivery_id)

    def tries(self, delivery_id):
        return [row for row in self.rows(DeliveryAttempt, DeliveryAttempt.number) if row.delivery_id == delivery_id]


@pytest.fixture
def outbox(database, settings, clock, organisation) -> Outbox:
    settings = settings.model_copy(update={"webhook_networks": LOOPBACK, "alert_attempts": 3})
    with database.transaction() as session:
        vehicle = Vehicle(organisation_id=organisation.id, name="Panda\nBcc: x@y.zz", created_at=clock())
        session.add(vehicle)
        session.flush()
        made, _ = register(
            session, organisation.id, DeviceIn(name="box", vehicle_id=vehicle.id), idempotency_key=None, now=clock()
        )
    return Outbox(database, settings, clock, organisation.id, made.id)


def hook_channel(outbox, hook, **more):
    return outbox.channel(WebhookIn(kind="webhook", name="hook", url=hook.url, **more))


@both
def test_a_webhook_gets_a_signed_post_once(outbox):
    with webhook() as hook:
        channel = hook_channel(outbox, hook)
        (owed,) = outbox.owe(channel)
        assert outbox.pay() == 1
        assert outbox.pay() == 0
    (got,) = hook.posts
    assert got.path == "/hook?a=1"
    signed = got.headers["Scatola-Timestamp"].encode() + b"." + got.body
    wanted = hmac.new(channel.secret.encode(), signed, hashlib.sha256).hexdigest()
    assert got.headers["Scatola-Signature"] == f"v1={wanted}"
    assert got.headers["Idempotency-Key"] == owed
    told = json.loads(got.body)
    assert told["schema"] == "scatola-alert-1"
    assert told["delivery_id"] == owed
    assert told["alert"]["facts"] == {"angle_deg": 34.0}
    assert told["alert"]["sentence"] == "The box was turned in its vehicle by 34°"
    row = outbox.row(owed)
    assert (row.state, row.attempts, row.error) == ("delivered", 1, None)
    (tried,) = outbox.tries(owed)
    assert (tried.outcome, tried.status) == ("delivered", 204)


@both
def test_failures_are_retried_with_the_same_bytes_until_it_works(outbox, clock):
    with webhook() as hook:
        hook.statuses = [500, 302]
        (owed,) = outbox.owe(hook_channel(outbox, hook))
        for failures in (1, 2):
            assert outbox.pay() == 1
            row = outbox.row(owed)
            wait = (row.due_at - clock()).total_seconds()
            assert 5.0 * 2 ** (failures - 1) <= wait <= 15.0 * 2 ** (failures - 1)
            clock.advance(seconds=wait - 0.1)
            assert outbox.pay() == 0
            clock.advance(seconds=0.2)
        assert outbox.pay() == 1
    assert outbox.row(owed).state == "delivered"
    assert len({one.body for one in hook.posts}) == 1
    assert {one.headers["Idempotency-Key"] for one in hook.posts} == {owed}
    assert [one.headers["Scatola-Attempt"] for one in hook.posts] == ["1", "2", "3"]
    assert len({one.headers["Scatola-Signature"] for one in hook.posts}) == 3
    assert [row.status for row in outbox.tries(owed)] == [500, 302, 204]


@both
def test_after_so_many_failures_it_is_dead_and_can_be_replayed(outbox, clock):
    with webhook() as hook:
        hook.statuses = [500] * 4
        channel = hook_channel(outbox, hook)
        (owed,) = outbox.owe(channel)
        for _ in range(3):
            outbox.pay()
            clock.advance(hours=1)
        assert outbox.row(owed).state == "dead"
        assert outbox.row(owed).error.startswith("the receiver answered 500")
        assert outbox.pay() == 0
        with outbox.database.transaction() as session:
            service.replay(session, outbox.organisation_id, owed, now=clock())
        assert outbox.pay() == 1
        assert outbox.row(owed).state == "waiting"
        clock.advance(hours=1)
        assert outbox.pay() == 1
    assert outbox.row(owed).state == "delivered"
    assert [row.number for row in outbox.tries(owed)] == [1, 2, 3, 4, 5]
    with outbox.database.transaction() as session, pytest.raises(ConflictError):
        service.replay(session, outbox.organisation_id, owed, now=clock())
    assert len(hook.posts) == 5


def test_all_dead_letters_of_a_channel_are_replayed(outbox, clock):
    with webhook() as hook:
        hook.statuses = [410, 410]
        channel = hook_channel(outbox, hook)
        owed = [*outbox.owe(channel), *outbox.owe(channel)]
        outbox.pay()
        # "Gone" means that nobody will ever be there.
        assert [outbox.row(one).state for one in owed] == ["dead", "dead"]
        with outbox.database.transaction() as session:
            assert service.replay_all(session, outbox.organisation_id, channel.id, now=clock()) == 2
        outbox.pay()
    assert [outbox.row(one).state for one in owed] == ["delivered", "delivered"]


@both
def test_deliveries_are_listed_a_page_at_a_time(outbox, admin):
    channel = mail_channel(outbox, "a@b.test")
    owed = {one for _ in range(5) for one in outbox.owe(channel)}
    path, seen, place = "/api/v1/alert-deliveries", [], {}
    while place is not None:
        page = admin.get(path, params={"limit": 2, **place}).raise_for_status().json()
        seen += [item["id"] for item in page["items"]]
        place = {"before": page["next"]} if page["next"] else None
    assert len(seen) == 5
    assert set(seen) == owed
    assert admin.get(path, params={"before": "nonsense"}).status_code == 422


def test_what_is_owed_to_a_deleted_channel_is_dead(outbox):
    with webhook() as hook:
        channel = hook_channel(outbox, hook)
        (owed,) = outbox.owe(channel)
        with outbox.database.transaction() as session:
            service.remove_channel(session, outbox.organisation_id, channel.id)
        outbox.pay()
    assert outbox.row(owed).state == "dead"
    assert hook.posts == []
    assert outbox.rows(AlertRule)[0].channels == []


@pytest.mark.parametrize("chance", [0.0, 0.999])
def test_pauses_double_to_a_limit(chance):
    ordinary = [pause_s(1, n, chance) / (0.5 + chance) for n in (1, 2, 3, 9, 10, 1000)]
    assert ordinary == pytest.approx([10.0, 20.0, 40.0, 2560.0, 3600.0, 3600.0])
    assert pause_s(0, 1, chance) <= 3.0
    assert pause_s(0, 50, chance) <= 180.0


# --- killed, raced, held up


SENDER = """
import sys, datetime as dt
from server.alerts.delivery import deliver_due
from server.database import Database
from server.settings import Settings
settings = Settings()
now = dt.datetime.fromisoformat(sys.argv[1])
deliver_due(Database(settings), settings, clock=lambda: now)
"""


@both
def test_a_sender_killed_between_taking_and_sending_leaves_nothing_undone(outbox, clock):
    with webhook() as hook:
        hook.hold = threading.Event()
        (owed,) = outbox.owe(hook_channel(outbox, hook))
        environment = {
            **os.environ,
            "SCATOLA_DATA_DIR": str(outbox.settings.data_dir),
            "SCATOLA_WEBHOOK_NETWORKS": "127.0.0.0/8",
        }
        if outbox.settings.database_url is not None:
            environment["SCATOLA_DATABASE_URL"] = outbox.settings.database_url.get_secret_value()
        child = subprocess.Popen([sys.executable, "-c", SENDER, clock().isoformat()], env=environment)
        assert hook.arrived.wait(60.0)
        child.send_signal(signal.SIGKILL)
        child.wait()
        hook.hold.set()
        row = outbox.row(owed)
        assert (row.state, row.attempts, row.due_at) == ("waiting", 1, clock() + LEASE)
        assert outbox.tries(owed)[0].ended_at is None
        # Nobody else takes it before the lease is over; then it goes again, recognisably the same.
        assert outbox.pay() == 0
        clock.advance(seconds=61)
        assert outbox.pay() == 1
    assert outbox.row(owed).state == "delivered"
    assert [one.headers["Idempotency-Key"] for one in hook.posts] == [owed, owed]
    assert [row.outcome for row in outbox.tries(owed)] == [None, "delivered"]


@both
def test_senders_that_race_send_each_message_once(outbox):
    with webhook() as hook:
        channel = hook_channel(outbox, hook)
        owed = [outbox.owe(channel)[0] for _ in range(12)]
        with ThreadPoolExecutor(4) as pool:
            assert sum(pool.map(lambda _: outbox.pay(), range(4))) == 12
    assert sorted(one.headers["Idempotency-Key"] for one in hook.posts) == sorted(owed)


def test_a_late_answer_does_not_undo_what_another_sender_did(outbox, clock, monkeypatch):
    with webhook() as hook:
        (owed,) = outbox.owe(hook_channel(outbox, hook))
        slow = Answer(delivered=False, status=None, detail="timed out")
        send = delivery._send

        def stall(*_):
            monkeypatch.setattr(delivery, "_send", send)
            clock.advance(seconds=61)
            outbox.pay()
            return slow

        monkeypatch.setattr(delivery, "_send", stall)
        outbox.pay()
    assert outbox.row(owed).state == "delivered"
    assert [row.outcome for row in outbox.tries(owed)] == ["failed", "delivered"]


def test_a_slow_receiver_holds_up_no_emergency(outbox, clock):
    severity = {
        "kind": "crash",
        "delta_v_kmh": 32.0,
        "delta_v_interval95_kmh": None,
        "pdof_clock": 12,
        "impact_speed_kmh": None,
        "rollover": False,
    }
    facts = {"severity": severity, "position": None, "course_deg": None, "delay_s": 2.0, "not_known": []}
    with webhook() as slow, webhook() as fast:
        slow.hold = threading.Event()
        outbox.owe(hook_channel(outbox, slow))
        stop = threading.Event()
        threads = delivery.start(outbox.database, outbox.settings, stop=stop, clock=clock)
        try:
            assert slow.arrived.wait(30.0)
            outbox.owe(hook_channel(outbox, fast, emergency=True), kind="emergency", facts=facts)
            began = time.monotonic()
            assert fast.arrived.wait(30.0)
            assert time.monotonic() - began < 5.0
        finally:
            slow.hold.set()
            stop.set()
            for thread in threads:
                thread.join(10.0)
    assert json.loads(fast.posts[0].body)["alert"]["kind"] == "emergency"


def test_one_sender_at_leisure_looks_for_all_and_a_stuck_one_holds_up_nobody(outbox, clock, monkeypatch):
    looking, most, looks = 0, 0, []
    any_due = delivery._any_due

    def counted(database, clock, priority):
        nonlocal looking, most
        looking += 1
        most = max(most, looking)
        looks.append(threading.get_ident())
        try:
            return any_due(database, clock, priority)
        finally:
            looking -= 1

    monkeypatch.setattr(delivery, "_any_due", counted)
    monkeypatch.setattr(delivery, "EMERGENCY_SENDERS", 0)
    with contextlib.ExitStack() as receivers:
        stuck = [receivers.enter_context(webhook()) for _ in range(delivery.ORDINARY_SENDERS - 1)]
        quick = receivers.enter_context(webhook())
        for each in stuck:
            each.hold = threading.Event()
            outbox.owe(hook_channel(outbox, each))
        stop = threading.Event()
        threads = delivery.start(outbox.database, outbox.settings, stop=stop, clock=clock)
        try:
            assert all(each.arrived.wait(30.0) for each in stuck)
            outbox.owe(hook_channel(outbox, quick))
            assert quick.arrived.wait(30.0)
        finally:
            for each in stuck:
                each.hold.set()
            stop.set()
            for thread in threads:
                thread.join(10.0)
    assert most == 1
    assert len(set(looks)) >= delivery.ORDINARY_SENDERS


# --- no way in


REFUSED = [
    "127.0.0.1",
    "0.0.0.0",
    "10.1.2.3",
    "172.16.0.1",
    "192.168.1.1",
    "169.254.169.254",
    "100.64.0.1",
    "192.0.2.1",
    "198.18.0.1",
    "224.0.0.1",
    "240.0.0.1",
    "255.255.255.255",
    "::1",
    "::",
    "fe80::1",
    "fc00::1",
    "ff02::1",
    "::ffff:127.0.0.1",
    "::ffff:10.0.0.1",
    "64:ff9b::7f00:1",
    "64:ff9b::a9fe:a9fe",
    "2002:7f00:1::",
    "2002:c0a8:101::1",
    "2001:db8::1",
]


@pytest.mark.parametrize("address", REFUSED)
def test_addresses_of_our_own_are_refused(address):
    with pytest.raises(RefusedTargetError):
        Guard().check(address)
    with pytest.raises(InvalidError):
        check_url(f"https://[{address}]/" if ":" in address else f"https://{address}/", Guard())
    answer = post("https://name.test/", b"{}", {}, guard=Guard(), resolver=lambda *_: ["93.184.215.14", address])
    assert not answer.delivered
    assert answer.detail.startswith("refused")


@pytest.mark.parametrize("address", ["93.184.215.14", "2606:2800:21f:cb07:6820:80da:af6b:8b2c", "::ffff:93.184.215.14"])
def test_public_addresses_are_not(address):
    Guard().check(address)


@pytest.mark.parametrize(
    "url",
    [
        "http://example.org/",
        "ftp://example.org/",
        "https://",
        "https:///x",
        "https://user:secret@example.org/",
        "https://example.org:0/",
        "https://example.org:99999/",
        "https://exa mple.org/",
        "https://example.org/\r\nX: y",
        "https://ex\u00e4mple.org/",
        "//example.org",
        "https://[::1",
        "https://" + "a" * 2000,
    ],
)
def test_addresses_that_are_none_are_refused(url):
    with pytest.raises(InvalidError):
        check_url(url, Guard())


def test_names_are_checked_when_they_are_used():
    """A name that stood for a public address when it was typed in, and for us when it is posted to."""
    check_url("https://rebound.test/", Guard())
    with webhook() as hook:
        port = int(hook.url.split(":")[2].split("/")[0])
        answer = post(f"https://rebound.test:{port}/", b"{}", {}, guard=Guard(), resolver=lambda *_: ["127.0.0.1"])
        plain = post(f"http://rebound.test:{port}/", b"{}", {}, guard=Guard(), resolver=lambda *_: ["127.0.0.1"])
    assert not answer.delivered
    assert not plain.delivered
    assert hook.posts == []


def test_without_the_operators_word_loopback_is_not_posted_to(outbox, settings):
    with webhook() as hook:
        (owed,) = outbox.owe(hook_channel(outbox, hook))
        outbox.pay(settings)
    assert hook.posts == []
    assert "not a public address" in outbox.row(owed).error


def test_redirects_are_not_followed(outbox):
    with webhook() as hook, webhook() as inner:
        hook.statuses, hook.location = [307], inner.url
        (owed,) = outbox.owe(hook_channel(outbox, hook))
        outbox.pay()
    assert inner.posts == []
    assert outbox.row(owed).state == "waiting"


def test_a_receiver_that_trickles_is_cut_off():
    with webhook() as hook:
        hook.trickle = True
        began = time.monotonic()
        answer = post(hook.url, b"{}", {}, guard=Guard(LOOPBACK), total_s=0.5)
        assert time.monotonic() - began < 5.0
    assert not answer.delivered


def test_nobody_there():
    answer = post(f"http://127.0.0.1:{free_port()}/", b"{}", {}, guard=Guard(LOOPBACK))
    assert (answer.delivered, answer.final) == (False, False)
    assert "Refused" in answer.detail


def test_tls_is_checked(tmp_path):
    certificate = make_certificate(tmp_path)
    with webhook(certificate) as hook:
        known = post(hook.url, b"{}", {}, guard=Guard(LOOPBACK), ca_file=certificate[0])
        unknown = post(hook.url, b"{}", {}, guard=Guard(LOOPBACK))
    assert known.delivered
    assert "CERTIFICATE_VERIFY_FAILED" in unknown.detail
    assert len(hook.posts) == 1


# --- e-mail


def mailing(outbox, box, **more):
    return outbox.settings.model_copy(
        update={"smtp_host": "127.0.0.1", "smtp_port": box.port, "smtp_sender": "scatola@fleet.test", **more}
    )


def mail_channel(outbox, *recipients):
    return outbox.channel(EmailIn(kind="email", name="mail", recipients=list(recipients)))


@both
def test_an_alert_is_mailed_over_tls_with_a_login(outbox, tmp_path):
    from pydantic import SecretStr

    certificate = make_certificate(tmp_path)
    with smtp_server(certificate) as box:
        settings = mailing(
            outbox,
            box,
            smtp_user="u",
            smtp_password=SecretStr("p"),
            alert_ca_file=certificate[0],
            public_url="https://fleet.test/",
        )
        (owed,) = outbox.owe(mail_channel(outbox, "a@b.test", "c@d.test"))
        assert outbox.pay(settings) == 1
    (mail,) = box.mails
    assert box.encrypted == [True]
    assert len(box.logins) == 1
    assert box.envelopes == [("scatola@fleet.test", ["a@b.test", "c@d.test"])]
    assert mail["Message-ID"] == f"<{owed}@fleet.test>"
    assert mail["Subject"] == "Box moved: box"
    text = mail.get_content()
    assert "turned in its vehicle by 34°" in text
    assert "https://fleet.test/alerts#alert-" in text
    assert outbox.row(owed).state == "delivered"


@both
def test_a_mail_is_in_the_languages_of_those_who_get_it(outbox):
    def person(email: str, language: str | None) -> None:
        wanted = UserIn(email=email, name="x", role="manager")
        with outbox.database.transaction() as session:
            caller = Caller(outbox.organisation_id, "admin")
            user, _ = add_user(session, outbox.organisation_id, caller, wanted, now=outbox.clock())
            user.preferences = Preferences(language=language).to_json()

    person("ida@b.test", "it")
    person("ann@b.test", "en")
    person("all@b.test", None)
    with smtp_server() as box:
        settings = mailing(outbox, box, smtp_security="none")
        for recipients in (["Ida@B.test"], ["ann@b.test"], ["ida@b.test", "elsewhere@c.test"], ["all@b.test"]):
            outbox.owe(mail_channel(outbox, *recipients))
            outbox.pay(settings)
    italian, english, both_, unsaid = box.mails
    assert italian["Subject"] == "Scatola mossa: box"
    assert italian.get_content().splitlines()[:2] == [
        "Scatola mossa: box",
        "La scatola è stata ruotata nel veicolo di 34°",
    ]
    assert "Quando: 2026-03-01 12:00:00 UTC" in italian.get_content()
    assert english["Subject"] == unsaid["Subject"] == "Box moved: box"
    assert "scatola" not in english.get_content()
    assert both_["Subject"] == "Box moved: box / Scatola mossa: box"
    text = both_.get_content()
    assert text.index("turned in its vehicle by 34°") < text.index("ruotata nel veicolo di 34°")


@pytest.mark.parametrize("language", list(LANGUAGES))
def test_an_emergency_is_said_whole_in_every_language(language):
    from server.language import catalogue

    place = {"lat_deg": 45.0, "lon_deg": 7.6, "radius95_m": 12.0, "age_s": 0.0, "source": "trajectory"}
    severity = {
        "kind": "rollover", "delta_v_kmh": 31.0, "delta_v_interval95_kmh": [28.0, 34.0], "pdof_clock": 12,
        "impact_speed_kmh": 50.0, "rollover": True,
    }  # fmt: skip
    facts = {"position": place, "course_deg": 90.0, "severity": severity, "delay_s": 600.0, "not_known": ["vin"]}
    at = dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC)
    alert = Alert(id="a", kind="emergency", at=at, facts=facts)
    subject = words.Subject(alert, None, Device(name="box"), None)
    text = words.mail_text(subject, AlertDelivery(reason="raised"), None, catalogue(language).gettext)
    assert "%" not in text.replace("95 %", "")
    for figure in ("45.000000", "12 m (95 %)", "90°", "28", "34", "50 km/h", "10 min", "vin"):
        assert figure in text, figure
    assert ("Occupants" in text) == (language == "en")


def test_a_name_with_a_line_break_makes_no_header(outbox):
    with smtp_server() as box:
        channel = mail_channel(outbox, "a@b.test")
        outbox.owe(channel)
        with outbox.database.transaction() as session:
            vehicle = session.scalars(select(Vehicle)).one()
            session.scalars(select(Alert)).one().vehicle_id = vehicle.id
        outbox.pay(mailing(outbox, box, smtp_security="none"))
    (mail,) = box.mails
    assert mail["Bcc"] is None
    assert mail["Subject"] == "Box moved: Panda Bcc: x@y.zz"


def test_no_mail_goes_in_the_clear_where_tls_is_wanted(outbox):
    with smtp_server() as box:
        (owed,) = outbox.owe(mail_channel(outbox, "a@b.test"))
        outbox.pay(mailing(outbox, box))
    assert box.mails == []
    assert outbox.row(owed).state == "waiting"
    assert "STARTTLS" in outbox.row(owed).error


def test_a_server_that_is_busy_is_asked_again(outbox, clock):
    with smtp_server() as box:
        box.failures = 1
        settings = mailing(outbox, box, smtp_security="none")
        (owed,) = outbox.owe(mail_channel(outbox, "a@b.test"))
        outbox.pay(settings)
        assert outbox.row(owed).error.endswith("421 come back later")
        clock.advance(minutes=1)
        outbox.pay(settings)
    assert outbox.row(owed).state == "delivered"
    assert [row.status for row in outbox.tries(owed)] == [421, 250]


def test_an_address_that_does_not_exist_is_dead_at_once_and_does_not_spoil_the_others(outbox):
    with smtp_server() as box:
        box.refuse = {"nobody@b.test"}
        settings = mailing(outbox, box, smtp_security="none")
        (alone,) = outbox.owe(mail_channel(outbox, "nobody@b.test"))
        (among,) = outbox.owe(mail_channel(outbox, "nobody@b.test", "a@b.test"))
        outbox.pay(settings)
    assert outbox.row(alone).state == "dead"
    assert outbox.row(among).state == "delivered"
    assert "nobody@b.test: 550" in outbox.tries(among)[0].detail
    assert len(box.mails) == 1


def test_without_a_mail_server_it_says_so(outbox):
    (owed,) = outbox.owe(mail_channel(outbox, "a@b.test"))
    outbox.pay()
    assert outbox.row(owed).error == "SCATOLA_SMTP_HOST is not set"
    assert outbox.rows(AlertChannel)[0].secret is None
    assert outbox.row(owed).due_at - outbox.clock() <= dt.timedelta(seconds=15)
