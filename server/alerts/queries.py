"""Alerts, rules, channels and deliveries as they are read."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence

from sqlalchemy import func, or_, select, tuple_
from sqlalchemy.orm import Session

from server.alerts.schemas import TheftOut
from server.errors import NotFoundError
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, DeliveryAttempt, GeofencePresence, TheftWatch
from server.vehicles.queries import vehicle_of


def rules(session: Session, organisation_id: str) -> Sequence[AlertRule]:
    """All rules, by name."""
    wanted = select(AlertRule).where(AlertRule.organisation_id == organisation_id)
    return session.scalars(wanted.order_by(AlertRule.name, AlertRule.id)).all()


def rule_of(session: Session, organisation_id: str, rule_id: str) -> AlertRule:
    """A rule of the organisation."""
    row = session.get(AlertRule, rule_id)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no rule {rule_id!r}")
    return row


def rules_on(session: Session, organisation_id: str, vehicle_id: str | None) -> Sequence[AlertRule]:
    """The rules that a vehicle falls under, or a box without one."""
    about = or_(AlertRule.vehicle_id.is_(None), AlertRule.vehicle_id == vehicle_id)
    return session.scalars(
        select(AlertRule).where(AlertRule.organisation_id == organisation_id, AlertRule.enabled, about)
    ).all()


def channels(session: Session, organisation_id: str) -> Sequence[AlertChannel]:
    """All channels, by name."""
    wanted = select(AlertChannel).where(AlertChannel.organisation_id == organisation_id)
    return session.scalars(wanted.order_by(AlertChannel.name, AlertChannel.id)).all()


def channel_of(session: Session, organisation_id: str, channel_id: str) -> AlertChannel:
    """A channel of the organisation."""
    row = session.get(AlertChannel, channel_id)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no channel {channel_id!r}")
    return row


def alerts(
    session: Session,
    organisation_id: str,
    *,
    kind: str | None = None,
    device_id: str | None = None,
    vehicle_id: str | None = None,
    waiting: bool | None = None,
    before: tuple[dt.datetime, str] | None = None,
    limit: int,
) -> Sequence[Alert]:
    """Alerts, the newest first; `waiting` for those that nobody acknowledged, or all but them."""
    query = select(Alert).where(Alert.organisation_id == organisation_id)
    for column, wanted in ((Alert.kind, kind), (Alert.device_id, device_id), (Alert.vehicle_id, vehicle_id)):
        if wanted is not None:
            query = query.where(column == wanted)
    if waiting is not None:
        query = query.where(Alert.acknowledged_at.is_(None) if waiting else Alert.acknowledged_at.is_not(None))
    if before is not None:
        query = query.where(tuple_(Alert.created_at, Alert.id) < before)
    return session.scalars(query.order_by(Alert.created_at.desc(), Alert.id.desc()).limit(limit)).all()


def alert_of(session: Session, organisation_id: str, alert_id: str, *, lock: bool = False) -> Alert:
    """An alert of the organisation."""
    row = session.get(Alert, alert_id, with_for_update=lock)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no alert {alert_id!r}")
    return row


def known(session: Session, organisation_id: str, occurrences: Collection[str]) -> dict[str, Alert]:
    """Alerts that there are of some occurrences."""
    if not occurrences:
        return {}
    wanted = select(Alert).where(Alert.organisation_id == organisation_id, Alert.occurrence.in_(occurrences))
    return {row.occurrence: row for row in session.scalars(wanted)}


def newest_of_rule(session: Session, rule_id: str | None, device_id: str, kind: str) -> Alert | None:
    """The last alert of a rule about a box."""
    wanted = select(Alert).where(Alert.device_id == device_id, Alert.rule_id == rule_id, Alert.kind == kind)
    return session.scalars(wanted.order_by(Alert.created_at.desc(), Alert.id.desc()).limit(1)).first()


def of_events(session: Session, organisation_id: str, event_ids: Collection[str]) -> Sequence[Alert]:
    """Alerts about events that have not recovered."""
    wanted = select(Alert).where(Alert.organisation_id == organisation_id, Alert.event_id.in_(event_ids))
    return session.scalars(wanted.where(Alert.recovered_at.is_(None))).all()


def presences(session: Session, device_id: str) -> dict[str, GeofencePresence]:
    """Where a box was to each fence, by rule."""
    wanted = select(GeofencePresence).where(GeofencePresence.device_id == device_id)
    return {row.rule_id: row for row in session.scalars(wanted)}


def watch_of(session: Session, vehicle_id: str | None) -> TheftWatch | None:
    """The theft watch over a vehicle."""
    return None if vehicle_id is None else session.get(TheftWatch, vehicle_id)


def deliveries(
    session: Session,
    organisation_id: str,
    *,
    state: str | None,
    alert_id: str | None,
    before: tuple[dt.datetime, str] | None = None,
    limit: int,
) -> Sequence[AlertDelivery]:
    """Deliveries, the newest first, from after `before` in that order."""
    query = select(AlertDelivery).where(AlertDelivery.organisation_id == organisation_id)
    if state is not None:
        query = query.where(AlertDelivery.state == state)
    if alert_id is not None:
        query = query.where(AlertDelivery.alert_id == alert_id)
    if before is not None:
        query = query.where(tuple_(AlertDelivery.created_at, AlertDelivery.id) < before)
    return session.scalars(query.order_by(AlertDelivery.created_at.desc(), AlertDelivery.id.desc()).limit(limit)).all()


def deliveries_in(session: Session, state: str) -> int:
    """How many there are in a state, over all organisations."""
    return session.scalar(select(func.count()).select_from(AlertDelivery).where(AlertDelivery.state == state)) or 0


def delivery_of(session: Session, organisation_id: str, delivery_id: str, *, lock: bool = False) -> AlertDelivery:
    """A delivery of the organisation."""
    row = session.get(AlertDelivery, delivery_id, with_for_update=lock)
    if row is None or row.organisation_id != organisation_id:
        raise NotFoundError(f"There is no delivery {delivery_id!r}")
    return row


def attempts(session: Session, delivery_id: str) -> Sequence[DeliveryAttempt]:
    """Every try at a delivery, the first one first."""
    wanted = select(DeliveryAttempt).where(DeliveryAttempt.delivery_id == delivery_id)
    return session.scalars(wanted.order_by(DeliveryAttempt.number)).all()


def waiting_count(session: Session, organisation_id: str) -> int:
    """Alerts that nobody acknowledged."""
    wanted = select(func.count()).select_from(Alert)
    return session.scalar(wanted.where(Alert.organisation_id == organisation_id, Alert.acknowledged_at.is_(None))) or 0


def theft(session: Session, organisation_id: str, vehicle_id: str) -> TheftOut:
    """How a vehicle is watched."""
    vehicle_of(session, organisation_id, vehicle_id)
    watch = watch_of(session, vehicle_id)
    by_ignition = any(rule.kind == "theft" for rule in rules_on(session, organisation_id, vehicle_id))
    return TheftOut(
        vehicle_id=vehicle_id,
        armed_at=None if watch is None else watch.armed_at,
        armed_by=None if watch is None else watch.armed_by,
        armed_by_ignition=by_ignition,
        alarm_at=None if watch is None else watch.alarm_at,
    )
