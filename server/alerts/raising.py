"""From findings to alerts and the deliveries that are owed for them.

An occurrence is one alert, however often it is looked at.  What happens again to the same box under the same rule
within the rule's cool-down is counted on the alert before and not told again.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy.orm import Session

from server.alerts import queries
from server.live.changes import announce
from server.models import Alert, AlertChannel, AlertDelivery, AlertRule, new_id

EMERGENCY, ORDINARY = 0, 1
_URGENT_KINDS = ("emergency", "theft")


@dataclass(frozen=True)
class Finding:
    """Something that a rule, or no rule, wants told."""

    rule: AlertRule | None
    kind: str
    severity: str
    occurrence: str
    at: dt.datetime
    facts: dict[str, Any]
    event_id: str | None = None


@dataclass
class Raised:
    """Rows to write, the deliveries after the alerts, and the alerts to announce."""

    alerts: list[Alert] = field(default_factory=list[Alert])
    deliveries: list[AlertDelivery] = field(default_factory=list[AlertDelivery])


def raise_all(
    session: Session,
    organisation_id: str,
    device_id: str,
    vehicle_id: str | None,
    findings: Iterable[Finding],
    *,
    now: dt.datetime,
) -> Raised:
    """Alerts for what was found; `session` is read only, the rows are written by whoever called."""
    found = {finding.occurrence: finding for finding in findings}
    raised = Raised()
    if not found:
        return raised
    known = queries.known(session, organisation_id, list(found))
    channels = queries.channels(session, organisation_id)
    newest: dict[tuple[str | None, str], Alert | None] = {}
    for occurrence, finding in found.items():
        if occurrence in known:
            continue
        key = None if finding.rule is None else finding.rule.id, finding.kind
        if key not in newest:
            newest[key] = queries.newest_of_rule(session, key[0], device_id, finding.kind)
        before = newest[key]
        if before is not None and finding.rule is not None and _is_hot(before, finding.rule, now):
            before.repeats += 1
            before.repeated_at = now
            if before not in raised.alerts:
                raised.alerts.append(before)
            continue
        alert = _alert(organisation_id, device_id, vehicle_id, finding, now)
        newest[key] = alert
        raised.alerts.append(alert)
        raised.deliveries += [_owed(alert, channel.id, "raised", now) for channel in _told(channels, finding)]
    return raised


def recover(session: Session, alerts: Sequence[Alert], *, now: dt.datetime) -> Raised:
    """What was wrong is right again: told to whom the alert was told."""
    raised = Raised()
    for alert in alerts:
        alert.recovered_at = now
        raised.alerts.append(alert)
        told = queries.deliveries(session, alert.organisation_id, state=None, alert_id=alert.id, limit=100)
        known = {row.channel_id for row in told if row.reason == "recovered"}
        for channel_id in sorted({row.channel_id for row in told} - known):
            raised.deliveries.append(_owed(alert, channel_id, "recovered", now))
    return raised


def _is_hot(before: Alert, rule: AlertRule, now: dt.datetime) -> bool:
    return now - before.created_at < dt.timedelta(seconds=rule.cooldown_s)


def _told(channels: Sequence[AlertChannel], finding: Finding) -> list[AlertChannel]:
    """The rule's channels, and those for emergencies where it is one."""
    wanted = set() if finding.rule is None else set(finding.rule.channels)
    urgent = finding.kind in _URGENT_KINDS
    return [row for row in channels if row.enabled and (row.id in wanted or (urgent and row.emergency))]


def _alert(organisation_id: str, device_id: str, vehicle_id: str | None, finding: Finding, now: dt.datetime) -> Alert:
    return Alert(
        id=new_id(),
        organisation_id=organisation_id,
        rule_id=None if finding.rule is None else finding.rule.id,
        kind=finding.kind,
        severity=finding.severity,
        occurrence=finding.occurrence,
        device_id=device_id,
        vehicle_id=vehicle_id,
        event_id=finding.event_id,
        at=finding.at,
        created_at=now,
        facts=finding.facts,
        repeats=0,
    )


def _owed(alert: Alert, channel_id: str, reason: str, now: dt.datetime) -> AlertDelivery:
    return AlertDelivery(
        id=new_id(),
        organisation_id=alert.organisation_id,
        alert_id=alert.id,
        channel_id=channel_id,
        reason=reason,
        priority=EMERGENCY if alert.kind in _URGENT_KINDS else ORDINARY,
        state="waiting",
        created_at=now,
        due_at=now,
        attempts=0,
    )


def announce_alert(session: Session, alert: Alert, now: dt.datetime) -> None:
    """Tell the live pages that an alert was raised, or looked after."""
    announce(
        session,
        "alert",
        at=now,
        organisation_id=alert.organisation_id,
        device_id=alert.device_id,
        vehicle_id=alert.vehicle_id,
        data={"alert_id": alert.id, "alert_kind": alert.kind, "severity": alert.severity},
    )
