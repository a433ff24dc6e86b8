"""Alerts as pages list them."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from server.alerts import words
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, Device, Vehicle
from server.pages.words import State

SHOWN = 100
DEAD_SHOWN = 20
_STATES: dict[str, State] = {"alarm": "alarm", "attention": "attention", "info": "unknown"}


@dataclass(frozen=True)
class AlertLine:
    """An alert in a list."""

    alert: Alert
    subject: words.Subject

    @property
    def url(self) -> str:
        return f"/alerts#alert-{self.alert.id}"

    @property
    def about(self) -> str:
        """Where what it is about is shown."""
        if self.alert.event_id:
            return f"/events/{self.alert.event_id}"
        return f"/vehicles/{self.alert.vehicle_id}" if self.subject.vehicle else f"/devices/{self.alert.device_id}"

    @property
    def name(self) -> str:
        return self.subject.vehicle.name if self.subject.vehicle else self.subject.device.name

    @property
    def kind(self) -> str:
        return words.KINDS[self.alert.kind]

    @property
    def state(self) -> State:
        over = self.alert.recovered_at is not None or self.alert.acknowledged_at is not None
        return "unknown" if over else _STATES[self.alert.severity]

    @property
    def parts(self) -> list[words.Part]:
        return words.parts(self.alert)


@dataclass(frozen=True)
class DeadLine:
    """A message that could not be delivered."""

    delivery: AlertDelivery
    alert: Alert
    channel: AlertChannel | None


def lines(session: Session, organisation_id: str, *, waiting: bool | None, limit: int = SHOWN) -> list[AlertLine]:
    """Alerts with what they are about, the newest first."""
    query = (
        select(Alert, Device, Vehicle, AlertRule)
        .join(Device, Device.id == Alert.device_id)
        .outerjoin(Vehicle, Vehicle.id == Alert.vehicle_id)
        .outerjoin(AlertRule, AlertRule.id == Alert.rule_id)
        .where(Alert.organisation_id == organisation_id)
    )
    if waiting is not None:
        query = query.where(Alert.acknowledged_at.is_(None) if waiting else Alert.acknowledged_at.is_not(None))
    rows = session.execute(query.order_by(Alert.created_at.desc(), Alert.id.desc()).limit(limit))
    return [AlertLine(alert, words.Subject(alert, rule, device, vehicle)) for alert, device, vehicle, rule in rows]


def dead_letters(session: Session, organisation_id: str) -> tuple[int, list[DeadLine]]:
    """How many messages could not be delivered, and the newest of them."""
    dead = AlertDelivery.organisation_id == organisation_id, AlertDelivery.state == "dead"
    count = session.scalar(select(func.count()).select_from(AlertDelivery).where(*dead)) or 0
    query = (
        select(AlertDelivery, Alert, AlertChannel)
        .join(Alert, Alert.id == AlertDelivery.alert_id)
        .outerjoin(AlertChannel, AlertChannel.id == AlertDelivery.channel_id)
        .where(*dead)
        .order_by(AlertDelivery.finished_at.desc())
        .limit(DEAD_SHOWN)
    )
    return count, [DeadLine(delivery, alert, channel) for delivery, alert, channel in session.execute(query)]
