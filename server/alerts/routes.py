"""Alerts, rules, channels, deliveries and theft mode over HTTP."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request
from sqlalchemy.orm import Session
from starlette.responses import Response

from server.accounts import audit
from server.accounts.access import Administrator, Caller, Reader, look_at_places
from server.accounts.places import Sight, seen, sight_of
from server.alerts import delivery, queries, service
from server.alerts.schemas import (
    AlertOut,
    AlertPage,
    AttemptOut,
    ChannelIn,
    ChannelMade,
    ChannelOut,
    DeliveryDetail,
    DeliveryOut,
    DeliveryPage,
    Kind,
    Replayed,
    RuleIn,
    RuleOut,
    TestOut,
    TheftIn,
    TheftOut,
)
from server.alerts.webhook import Guard
from server.database import Database
from server.edge import DatabaseOf, Now, SettingsOf, place_of
from server.models import Alert, AlertRule
from server.problems import described
from server.settings import Settings

router = APIRouter(prefix="/api/v1", tags=["alerts"])

Id = Annotated[str, Path(max_length=32)]
_SURENESS = {"radius95_m"}
_MSD_PLACES = ("vehicleLocation", "recentVehicleLocationN1", "recentVehicleLocationN2")


@router.get("/alerts")
def list_alerts(
    request: Request,
    caller: Reader,
    database: DatabaseOf,
    kind: Annotated[Kind | None, Query()] = None,
    device: Annotated[str | None, Query(max_length=32)] = None,
    vehicle: Annotated[str | None, Query(max_length=32)] = None,
    waiting: Annotated[bool | None, Query(description="those that nobody acknowledged, or all but them")] = None,
    before: Annotated[str | None, Query(max_length=100)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> AlertPage:
    """Alerts, the newest first, a page at a time."""
    look_at_places(request, caller)
    with database.reading() as session:
        rows = queries.alerts(
            session,
            caller.organisation_id,
            kind=kind,
            device_id=device,
            vehicle_id=vehicle,
            waiting=waiting,
            before=None if before is None else place_of(before),
            limit=limit + 1,
        )
    last = rows[limit - 1] if len(rows) > limit else None
    return AlertPage(
        items=[alert_out(row, sight_of(caller)) for row in rows[:limit]],
        next=None if last is None else f"{last.created_at.isoformat()}~{last.id}",
    )


@router.get("/alerts/{alert_id}")
def read_alert(request: Request, alert_id: Id, caller: Reader, database: DatabaseOf) -> AlertOut:
    """One alert; of an emergency with the message that was sent."""
    look_at_places(request, caller)
    with database.reading() as session:
        row = queries.alert_of(session, caller.organisation_id, alert_id)
        return alert_out(row, sight_of(caller))


@router.post("/alerts/{alert_id}/acknowledge")
def acknowledge(request: Request, alert_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> AlertOut:
    """Say that somebody looks after it."""
    look_at_places(request, caller)
    with database.transaction() as session:
        row = service.acknowledge(session, caller.organisation_id, alert_id, actor=caller.name, now=now)
        return alert_out(row, sight_of(caller))


@router.get("/alert-rules")
def list_rules(caller: Reader, database: DatabaseOf) -> list[RuleOut]:
    """What the organisation wants to be told of."""
    with database.reading() as session:
        return [rule_out(row) for row in queries.rules(session, caller.organisation_id)]


@router.post("/alert-rules", status_code=201, responses=described(409))
def add_rule(wanted: RuleIn, caller: Administrator, database: DatabaseOf, now: Now) -> RuleOut:
    """Be told of something."""
    with database.transaction() as session:
        rule_id = service.set_rule(session, caller.organisation_id, None, wanted, now=now)
        row = queries.rule_of(session, caller.organisation_id, rule_id)
        note_rule(session, caller, "rule.added", row, now=now)
        return rule_out(row)


@router.get("/alert-rules/{rule_id}")
def read_rule(rule_id: Id, caller: Reader, database: DatabaseOf) -> RuleOut:
    """One rule."""
    with database.reading() as session:
        return rule_out(queries.rule_of(session, caller.organisation_id, rule_id))


@router.put("/alert-rules/{rule_id}", responses=described(409))
def change_rule(rule_id: Id, wanted: RuleIn, caller: Administrator, database: DatabaseOf, now: Now) -> RuleOut:
    """The whole rule anew; its kind stays."""
    with database.transaction() as session:
        service.set_rule(session, caller.organisation_id, rule_id, wanted, now=now)
        row = queries.rule_of(session, caller.organisation_id, rule_id)
        note_rule(session, caller, "rule.changed", row, now=now)
        return rule_out(row)


@router.delete("/alert-rules/{rule_id}", status_code=204)
def remove_rule(rule_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Look for it no more; its alerts stay."""
    with database.transaction() as session:
        row = queries.rule_of(session, caller.organisation_id, rule_id)
        note_rule(session, caller, "rule.removed", row, now=now)
        service.remove_rule(session, caller.organisation_id, rule_id)
    return Response(status_code=204)


@router.get("/alert-channels")
def list_channels(caller: Administrator, database: DatabaseOf) -> list[ChannelOut]:
    """Where alerts go."""
    with database.reading() as session:
        found = queries.channels(session, caller.organisation_id)
        return [ChannelOut.model_validate(row, from_attributes=True) for row in found]


@router.post("/alert-channels", status_code=201, responses=described(409))
def add_channel(
    wanted: ChannelIn, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now
) -> ChannelMade:
    """Add an e-mail or webhook channel; a webhook's secret is shown once, here."""
    with database.transaction() as session:
        made = service.add_channel(
            session, caller.organisation_id, wanted, guard=Guard(settings.webhook_networks), now=now
        )
        note_channel(session, caller, "channel.added", made, now)
    return made


@router.get("/alert-channels/{channel_id}")
def read_channel(channel_id: Id, caller: Administrator, database: DatabaseOf) -> ChannelOut:
    """One channel, without its secret."""
    with database.reading() as session:
        row = queries.channel_of(session, caller.organisation_id, channel_id)
        return ChannelOut.model_validate(row, from_attributes=True)


@router.put("/alert-channels/{channel_id}", responses=described(409))
def change_channel(
    channel_id: Id,
    wanted: ChannelIn,
    caller: Administrator,
    settings: SettingsOf,
    database: DatabaseOf,
    now: Now,
) -> ChannelOut:
    """The whole channel anew; its kind and its secret stay."""
    with database.transaction() as session:
        row = service.change_channel(
            session, caller.organisation_id, channel_id, wanted, guard=Guard(settings.webhook_networks)
        )
        told = ChannelOut.model_validate(row, from_attributes=True)
        note_channel(session, caller, "channel.changed", told, now)
    return told


@router.post("/alert-channels/{channel_id}/secret", responses=described(409))
def new_secret(channel_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> ChannelMade:
    """Another secret for a webhook, shown once; the old one ends at once."""
    with database.transaction() as session:
        made = service.new_secret(session, caller.organisation_id, channel_id)
        note_channel(session, caller, "channel.secret", made, now)
    return made


@router.post("/alert-channels/{channel_id}/test")
def send_test(channel_id: Id, caller: Administrator, settings: SettingsOf, database: DatabaseOf, now: Now) -> TestOut:
    """Send a message that says it is a test, at once and once; what came of it."""
    return tested(channel_id, caller, settings, database, now)


def tested(channel_id: str, caller: Caller, settings: Settings, database: Database, now: dt.datetime) -> TestOut:
    """Try a channel outside any transaction, and tell the audit log."""
    with database.reading() as session:
        row = queries.channel_of(session, caller.organisation_id, channel_id)
        languages = delivery.languages_of(session, row)
    answer = delivery.send_test(settings, row, now=now, languages=languages)
    told = TestOut(delivered=answer.delivered, status=answer.status, detail=answer.detail)
    with database.transaction() as session:
        detail = {"name": row.name, "delivered": told.delivered, "status": told.status}
        audit.record(session, caller, "channel.tested", f"channel={channel_id}", now=now, detail=detail)
    return told


@router.post("/alert-channels/{channel_id}/replay")
def replay_channel(channel_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> Replayed:
    """Try all dead letters of a channel again."""
    with database.transaction() as session:
        return Replayed(replayed=service.replay_all(session, caller.organisation_id, channel_id, now=now))


@router.delete("/alert-channels/{channel_id}", status_code=204)
def remove_channel(channel_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> Response:
    """Tell nobody there any more."""
    with database.transaction() as session:
        row = queries.channel_of(session, caller.organisation_id, channel_id)
        told = ChannelOut.model_validate(row, from_attributes=True)
        service.remove_channel(session, caller.organisation_id, channel_id)
        note_channel(session, caller, "channel.removed", told, now)
    return Response(status_code=204)


@router.get("/alert-deliveries")
def list_deliveries(
    caller: Administrator,
    database: DatabaseOf,
    state: Annotated[Literal["waiting", "delivered", "dead"] | None, Query()] = None,
    alert: Annotated[str | None, Query(max_length=32)] = None,
    before: Annotated[str | None, Query(max_length=100)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> DeliveryPage:
    """What was and is to be sent, the newest first, a page at a time."""
    with database.reading() as session:
        rows = queries.deliveries(
            session,
            caller.organisation_id,
            state=state,
            alert_id=alert,
            before=None if before is None else place_of(before),
            limit=limit + 1,
        )
    last = rows[limit - 1] if len(rows) > limit else None
    return DeliveryPage(
        items=[DeliveryOut.model_validate(row, from_attributes=True) for row in rows[:limit]],
        next=None if last is None else f"{last.created_at.isoformat()}~{last.id}",
    )


@router.get("/alert-deliveries/{delivery_id}")
def read_delivery(delivery_id: Id, caller: Administrator, database: DatabaseOf) -> DeliveryDetail:
    """One delivery with every try."""
    with database.reading() as session:
        row = queries.delivery_of(session, caller.organisation_id, delivery_id)
        tries = queries.attempts(session, delivery_id)
    return DeliveryDetail(
        **DeliveryOut.model_validate(row, from_attributes=True).model_dump(),
        tries=[AttemptOut.model_validate(each, from_attributes=True) for each in tries],
    )


@router.post("/alert-deliveries/{delivery_id}/replay", responses=described(409))
def replay(delivery_id: Id, caller: Administrator, database: DatabaseOf, now: Now) -> DeliveryOut:
    """Try a dead letter again."""
    with database.transaction() as session:
        row = service.replay(session, caller.organisation_id, delivery_id, now=now)
        return DeliveryOut.model_validate(row, from_attributes=True)


@router.get("/vehicles/{vehicle_id}/theft")
def read_theft(vehicle_id: Id, caller: Reader, database: DatabaseOf) -> TheftOut:
    """How a vehicle is watched."""
    with database.reading() as session:
        return queries.theft(session, caller.organisation_id, vehicle_id)


@router.put("/vehicles/{vehicle_id}/theft")
def put_theft(vehicle_id: Id, wanted: TheftIn, caller: Administrator, database: DatabaseOf, now: Now) -> TheftOut:
    """Arm a vehicle by hand, so that any movement is an alarm; or end that, and an alarm."""
    with database.transaction() as session:
        arm(session, caller, vehicle_id, armed=wanted.armed, now=now)
        session.flush()
        return queries.theft(session, caller.organisation_id, vehicle_id)


def arm(session: Session, caller: Caller, vehicle_id: str, *, armed: bool, now: dt.datetime) -> None:
    """Arm or disarm, and tell the audit log."""
    service.arm(session, caller.organisation_id, vehicle_id, armed=armed, actor=caller.name, now=now)
    audit.record(session, caller, "theft.armed" if armed else "theft.ended", f"vehicle={vehicle_id}", now=now)


def rule_out(row: AlertRule) -> RuleOut:
    """A rule as JSON."""
    own = ("id", "name", "enabled", "vehicle_id", "channels", "cooldown_s", "created_at")
    condition = {"kind": row.kind, **row.parameters}
    return RuleOut.model_validate({**{name: getattr(row, name) for name in own}, "condition": condition})


def alert_out(row: Alert, sight: Sight) -> AlertOut:
    """An alert as JSON, its places as the caller may see them."""
    told = AlertOut.model_validate(row, from_attributes=True)
    if sight != "exact":
        told.facts = _with_places(told.facts, sight)
    return told


def _with_places(facts: dict[str, Any], sight: Sight) -> dict[str, Any]:
    """Facts for whoever may not see exactly where vehicles are: a cell's middle, and no message for rescuers."""
    told = dict(facts)
    position: dict[str, Any] | None = facts.get("position")
    if position is not None:
        place = seen(position["lat_deg"], position["lon_deg"], sight)
        cell = {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg} if place is not None else None
        # How sure the exact place was would be a lie about the cell's.
        told["position"] = None if cell is None else {**position, **cell, **dict.fromkeys(_SURENESS & position.keys())}
    msd: dict[str, Any] | None = told.get("msd")
    if msd is not None:
        told["msd"] = {name: None if name in _MSD_PLACES else value for name, value in msd.items()}
    return told


def note_channel(session: Session, caller: Caller, action: str, channel: ChannelOut, now: dt.datetime) -> None:
    """Tell the audit log of a channel."""
    detail = {"kind": channel.kind, "name": channel.name, "emergency": channel.emergency, "enabled": channel.enabled}
    audit.record(session, caller, action, f"channel={channel.id}", now=now, detail=detail)


def note_rule(session: Session, caller: Caller, action: str, rule: AlertRule, *, now: dt.datetime) -> None:
    """Tell the audit log of a rule."""
    detail = {"kind": rule.kind, "name": rule.name, "enabled": rule.enabled}
    audit.record(session, caller, action, f"rule={rule.id}", now=now, detail=detail)
