"""What only the clock tells: boxes that fell silent, mountings that stay unknown; and when that is over."""

from __future__ import annotations

import datetime as dt
import threading

import structlog
from sqlalchemy import ColumnElement, Select, or_, select
from sqlalchemy.orm import Session, aliased

from server.alerts.raising import Finding, Raised, announce_alert, raise_all, recover
from server.database import Database
from server.models import Alert, AlertRule, Device, Installation
from server.moments import Clock

EVERY_S = 15.0
AT_ONCE = 500
"""Boxes of one rule in one transaction; the next sweep takes the rest."""

log = structlog.stdlib.get_logger("scatola.alerts")


def sweep(database: Database, *, clock: Clock) -> int:
    """Look at every rule of this kind once; how many alerts were raised or recovered."""
    with database.reading() as session:
        wanted = select(AlertRule.id).where(AlertRule.kind.in_(("silent", "calibration")), AlertRule.enabled)
        rules = session.scalars(wanted.order_by(AlertRule.id)).all()
    told = 0
    for rule_id in rules:
        with database.transaction() as session:
            # Its row is the lock: sweeps of several workers take turns at a rule, or pass it over.
            rule = session.get(AlertRule, rule_id, with_for_update={"skip_locked": True})
            if rule is not None:
                told += _look(session, rule, clock())
    return told


def _look(session: Session, rule: AlertRule, now: dt.datetime) -> int:
    silent = rule.kind == "silent"
    told = _write(session, recover(session, session.scalars(_over(rule, now, silent=silent)).all(), now=now), now)
    found = session.execute(_silent(rule, now) if silent else _uncalibrated(rule, now)).all()
    for device, since in found:
        assert since is not None  # both ask for it
        finding = Finding(
            rule,
            rule.kind,
            "attention",
            f"{rule.kind}/{rule.id}/{device.id}/{since.isoformat()}/{rule.parameters['hours']:g}",
            since,
            {"hours": rule.parameters["hours"], "since": since.isoformat()},
        )
        raised = raise_all(session, rule.organisation_id, device.id, device.vehicle_id, [finding], now=now)
        told += _write(session, raised, now)
    return told


def _write(session: Session, raised: Raised, now: dt.datetime) -> int:
    session.add_all(raised.alerts)
    session.flush()
    session.add_all(raised.deliveries)
    for alert in raised.alerts:
        announce_alert(session, alert, now)
    return len(raised.alerts)


def _hours(rule: AlertRule) -> dt.timedelta:
    return dt.timedelta(hours=float(rule.parameters["hours"]))


def _boxes(rule: AlertRule) -> list[ColumnElement[bool]]:
    """Boxes in use that the rule is about."""
    conditions: list[ColumnElement[bool]] = [
        Device.organisation_id == rule.organisation_id,
        Device.revoked_at.is_(None),
    ]
    if rule.vehicle_id is not None:
        conditions.append(Device.vehicle_id == rule.vehicle_id)
    return conditions


def _not_told(rule: AlertRule, now: dt.datetime) -> ColumnElement[bool]:
    """No alert of the rule is open or within its cool-down: what lasts is told when that is over."""
    other = aliased(Alert)
    recent = other.created_at > now - dt.timedelta(seconds=rule.cooldown_s)
    told = select(other.id).where(
        other.device_id == Device.id, other.rule_id == rule.id, or_(other.recovered_at.is_(None), recent)
    )
    return ~told.exists()


def _silent(rule: AlertRule, now: dt.datetime) -> Select[Device, dt.datetime | None]:
    """Boxes that were heard once, and not for too long."""
    conditions = [*_boxes(rule), Device.last_seen_at < now - _hours(rule), _not_told(rule, now)]
    return select(Device, Device.last_seen_at).where(*conditions).order_by(Device.id).limit(AT_ONCE)


def _uncalibrated(rule: AlertRule, now: dt.datetime) -> Select[Device, dt.datetime]:
    """Boxes whose present mounting began too long ago and is not ready, though they report."""
    open_installation = Installation.device_id == Device.id, Installation.ended_at.is_(None)
    conditions = [
        *_boxes(rule),
        Installation.status != "ready",
        Installation.began_at < now - _hours(rule),
        Device.last_seen_at > Installation.began_at,
        _not_told(rule, now),
    ]
    wanted = select(Device, Installation.began_at).join(Installation, (open_installation[0]) & open_installation[1])
    return wanted.where(*conditions).order_by(Device.id).limit(AT_ONCE)


def _over(rule: AlertRule, now: dt.datetime, *, silent: bool) -> Select[Alert]:
    """Open alerts of the rule whose box reports again, or whose mounting is ready; of a revoked box they just end."""
    wanted = select(Alert).join(Device, Device.id == Alert.device_id)
    wanted = wanted.where(Alert.rule_id == rule.id, Alert.recovered_at.is_(None))
    if silent:
        right = Device.last_seen_at >= now - _hours(rule)
    else:
        right = (
            select(Installation.id)
            .where(Installation.device_id == Device.id, Installation.ended_at.is_(None), Installation.status == "ready")
            .exists()
        )
    return wanted.where(or_(right, Device.revoked_at.is_not(None))).order_by(Alert.id).limit(AT_ONCE)


def start(database: Database, *, stop: threading.Event, clock: Clock) -> threading.Thread:
    """Sweep in the background."""

    def run() -> None:
        while not stop.wait(EVERY_S):
            try:
                sweep(database, clock=clock)
            except Exception:
                log.exception("rules cannot be looked at")

    thread = threading.Thread(target=run, name="alert rules", daemon=True)
    thread.start()
    return thread
