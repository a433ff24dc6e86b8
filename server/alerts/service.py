"""Rules, channels, acknowledging, replaying, theft mode: what people do."""

from __future__ import annotations

import datetime as dt

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from server.accounts.secrets import new_token
from server.alerts import queries
from server.alerts.raising import announce_alert, recover
from server.alerts.schemas import COOLDOWN_S, ChannelIn, ChannelMade, EmailIn, RuleIn, WebhookIn
from server.alerts.webhook import Guard, check_url
from server.errors import ConflictError, InvalidError
from server.live.changes import announce
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, GeofencePresence, TheftWatch, new_id
from server.vehicles.queries import vehicle_of

SECRET_PREFIX = "scw_"  # noqa: S105  lets scanners find one that leaked
MAX_RULES, MAX_CHANNELS = 500, 100


def set_rule(session: Session, organisation_id: str, rule_id: str | None, wanted: RuleIn, *, now: dt.datetime) -> str:
    """A new rule, or all of one anew; its id."""
    if wanted.vehicle_id is not None:
        vehicle_of(session, organisation_id, wanted.vehicle_id)
    known = {channel.id for channel in queries.channels(session, organisation_id)}
    unknown = [channel for channel in wanted.channels if channel not in known]
    if unknown:
        raise InvalidError(f"There is no channel {unknown[0]!r}", code="unknown_channel")
    if rule_id is not None:
        row = queries.rule_of(session, organisation_id, rule_id)
        if row.kind != wanted.condition.kind:
            raise ConflictError("A rule keeps its kind; make another one", code="rule_kind")
    else:
        if len(queries.rules(session, organisation_id)) >= MAX_RULES:
            raise ConflictError(f"An organisation has at most {MAX_RULES} rules", code="rules_full")
        row = AlertRule(id=new_id(), organisation_id=organisation_id, created_at=now, kind=wanted.condition.kind)
        session.add(row)
    row.name, row.enabled, row.vehicle_id = wanted.name, wanted.enabled, wanted.vehicle_id
    parameters = wanted.condition.model_dump(mode="json", exclude={"kind"})
    if rule_id is not None and row.parameters != parameters:
        # To another fence nobody knows yet who is inside.
        session.execute(delete(GeofencePresence).where(GeofencePresence.rule_id == rule_id))
    row.parameters = parameters
    row.channels = list(dict.fromkeys(wanted.channels))
    row.cooldown_s = COOLDOWN_S.get(row.kind, 0.0) if wanted.cooldown_s is None else wanted.cooldown_s
    session.flush()
    return row.id


def remove_rule(session: Session, organisation_id: str, rule_id: str) -> None:
    """Look for it no more; its alerts stay."""
    session.delete(queries.rule_of(session, organisation_id, rule_id))


def add_channel(
    session: Session, organisation_id: str, wanted: ChannelIn, *, guard: Guard, now: dt.datetime
) -> ChannelMade:
    """A new channel; a webhook's secret is shown here and never again."""
    if len(queries.channels(session, organisation_id)) >= MAX_CHANNELS:
        raise ConflictError(f"An organisation has at most {MAX_CHANNELS} channels", code="channels_full")
    row = AlertChannel(id=new_id(), organisation_id=organisation_id, kind=wanted.kind, created_at=now)
    row.secret = new_token(SECRET_PREFIX) if wanted.kind == "webhook" else None
    _fill(row, wanted, guard)
    session.add(row)
    session.flush()
    return ChannelMade.model_validate(row, from_attributes=True)


def change_channel(
    session: Session, organisation_id: str, channel_id: str, wanted: ChannelIn, *, guard: Guard
) -> AlertChannel:
    """All of a channel anew, but its secret."""
    row = queries.channel_of(session, organisation_id, channel_id)
    if row.kind != wanted.kind:
        raise ConflictError("A channel keeps its kind; make another one", code="channel_kind")
    _fill(row, wanted, guard)
    return row


def _fill(row: AlertChannel, wanted: EmailIn | WebhookIn, guard: Guard) -> None:
    if isinstance(wanted, WebhookIn):
        check_url(wanted.url, guard)
    row.name, row.emergency, row.enabled = wanted.name, wanted.emergency, wanted.enabled
    row.recipients = [wanted.url] if isinstance(wanted, WebhookIn) else list(wanted.recipients)


def new_secret(session: Session, organisation_id: str, channel_id: str) -> ChannelMade:
    """Another secret for a webhook; the old one signs nothing more."""
    row = queries.channel_of(session, organisation_id, channel_id)
    if row.kind != "webhook":
        raise ConflictError("Only a webhook has a secret", code="channel_kind")
    row.secret = new_token(SECRET_PREFIX)
    session.flush()
    return ChannelMade.model_validate(row, from_attributes=True)


def remove_channel(session: Session, organisation_id: str, channel_id: str) -> None:
    """Tell nobody there any more: what is still owed goes to the dead letters."""
    row = queries.channel_of(session, organisation_id, channel_id)
    for rule in queries.rules(session, organisation_id):
        if channel_id in rule.channels:
            rule.channels = [channel for channel in rule.channels if channel != channel_id]
    session.delete(row)


def acknowledge(session: Session, organisation_id: str, alert_id: str, *, actor: str, now: dt.datetime) -> Alert:
    """Somebody looks after it; the first who says so is kept."""
    alert = queries.alert_of(session, organisation_id, alert_id, lock=True)
    if alert.acknowledged_at is None:
        alert.acknowledged_at, alert.acknowledged_by = now, actor[:254]
        announce_alert(session, alert, now)
    return alert


def replay(session: Session, organisation_id: str, delivery_id: str, *, now: dt.datetime) -> AlertDelivery:
    """Try a dead letter again, as often as a new one."""
    row = queries.delivery_of(session, organisation_id, delivery_id, lock=True)
    if row.state != "dead":
        raise ConflictError(f"The delivery is {row.state}; only dead ones are replayed", code="not_dead")
    _revive(row, now)
    return row


def replay_all(session: Session, organisation_id: str, channel_id: str, *, now: dt.datetime) -> int:
    """Try all dead letters of a channel again."""
    queries.channel_of(session, organisation_id, channel_id)
    wanted = select(AlertDelivery).where(
        AlertDelivery.organisation_id == organisation_id,
        AlertDelivery.channel_id == channel_id,
        AlertDelivery.state == "dead",
    )
    rows = session.scalars(wanted.with_for_update()).all()
    for row in rows:
        _revive(row, now)
    return len(rows)


def _revive(row: AlertDelivery, now: dt.datetime) -> None:
    row.state, row.attempts, row.due_at, row.finished_at = "waiting", 0, now, None


def arm(session: Session, organisation_id: str, vehicle_id: str, *, armed: bool, actor: str, now: dt.datetime) -> None:
    """Arm by hand; or end that, and an alarm with it."""
    vehicle_of(session, organisation_id, vehicle_id)
    watch = session.get(TheftWatch, vehicle_id, with_for_update=True)
    if watch is None:
        watch = TheftWatch(vehicle_id=vehicle_id, organisation_id=organisation_id)
        session.add(watch)
    if armed:
        if watch.armed_at is None:
            watch.armed_at, watch.armed_by = now, actor[:254]
    else:
        watch.armed_at = watch.armed_by = watch.alarm_at = None
        _end_alarm(session, organisation_id, vehicle_id, now)
    announce(session, "vehicle", at=now, organisation_id=organisation_id, vehicle_id=vehicle_id)


def _end_alarm(session: Session, organisation_id: str, vehicle_id: str, now: dt.datetime) -> None:
    wanted = select(Alert).where(
        Alert.organisation_id == organisation_id,
        Alert.vehicle_id == vehicle_id,
        Alert.kind == "theft",
        Alert.recovered_at.is_(None),
    )
    over = recover(session, session.scalars(wanted).all(), now=now)
    session.add_all(over.deliveries)
    for alert in over.alerts:
        announce_alert(session, alert, now)
