"""An alert in words: subject, sentences, and the JSON of a webhook; one catalogue, so a language can be added."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import orjson

from server.models import Alert, AlertDelivery, AlertRule, Device, Vehicle
from server.wording import marked

SCHEMA = "scatola-alert-1"

KINDS = {
    "emergency": marked("EMERGENCY: crash"),
    "crash": marked("Crash"),
    "moved": marked("Box moved"),
    "silent": marked("Box silent"),
    "calibration": marked("Not calibrated"),
    "harsh": marked("Harsh driving"),
    "geofence": marked("Geofence"),
    "theft": marked("Theft alarm"),
}
RECOVERED = {
    "emergency": "Withdrawn: later data show no such crash",
    "crash": "Withdrawn: later data show no such event",
    "silent": "The box reports again",
    "calibration": "The mounting is ready",
    "theft": "The alarm was ended",
}
_BLOWS = {
    "crash": marked("Crash"),
    "rollover": marked("Rollover"),
    "parked_impact": marked("Impact while parked"),
}
_THEFTS = {
    "moves without ignition": marked("The vehicle moves without ignition"),
    "moves although armed": marked("The vehicle moves although it is armed"),
}
Part = tuple[str, dict[str, str]]
"""A text of the catalogues, and the values for its places."""


@dataclass(frozen=True)
class Subject:
    """An alert and what it is about, read once."""

    alert: Alert
    rule: AlertRule | None
    device: Device
    vehicle: Vehicle | None

    @property
    def name(self) -> str:
        """Of the vehicle, with its plate; of the box where it sits in none."""
        if self.vehicle is None:
            return self.device.name
        return f"{self.vehicle.name} ({self.vehicle.plate})" if self.vehicle.plate else self.vehicle.name


def headline(subject: Subject) -> str:
    """What and which vehicle."""
    return f"{KINDS[subject.alert.kind]}: {subject.name}"


def sentence(alert: Alert) -> str:
    """What happened, in one line, without a place."""
    return ", ".join(pattern % values for pattern, values in parts(alert))


def parts(alert: Alert) -> list[Part]:
    """What `sentence` says, in parts that a page translates."""
    return _PARTS[alert.kind](alert.facts)


def _blow(kind: str, delta_v_kmh: float | None, clock: int | None) -> list[Part]:
    size, where = (marked("delta-V not known"), {}), (marked("direction not known"), {})
    if delta_v_kmh is not None:
        size = marked("delta-V %(value)s km/h"), {"value": f"{delta_v_kmh:.0f}"}
    if clock is not None:
        where = marked("force from %(clock)s o'clock"), {"clock": str(clock)}
    return [(_BLOWS[kind], {}), size, where]


def _moved(facts: Mapping[str, Any]) -> list[Part]:
    angle = facts["angle_deg"]
    if angle is None:
        return [(marked("The box was turned in its vehicle"), {})]
    return [(marked("The box was turned in its vehicle by %(angle)s°"), {"angle": f"{angle:.0f}"})]


def _harsh(facts: Mapping[str, Any]) -> list[Part]:
    values = {"count": str(facts["count"]), "limit": f"{facts['limit']:g}", "km": f"{facts['kilometres']:g}"}
    if facts["per"] == "day":
        return [(marked("%(count)s harsh events that day; the rule's limit is %(limit)s"), values)]
    return [(marked("%(count)s harsh events on %(km)s km; the rule's limit is %(limit)s per 100 km"), values)]


def _of_severity(facts: Mapping[str, Any]) -> list[Part]:
    severity = facts["severity"]
    return _blow(severity["kind"], severity["delta_v_kmh"], severity["pdof_clock"])


def _hours(pattern: str) -> Callable[[Mapping[str, Any]], list[Part]]:
    return lambda facts: [(pattern, {"hours": f"{facts['hours']:g}"})]


def _fence(facts: Mapping[str, Any]) -> list[Part]:
    entered = facts["passage"] == "entered"
    pattern = marked("The vehicle entered %(fence)s") if entered else marked("The vehicle left %(fence)s")
    return [(pattern, {"fence": facts["fence"]})]


_PARTS: dict[str, Callable[[Mapping[str, Any]], list[Part]]] = {
    "emergency": _of_severity,
    "crash": lambda facts: _blow(facts["event_kind"], facts["delta_v_kmh"], facts["pdof_clock"]),
    "moved": _moved,
    "silent": _hours(marked("No upload for %(hours)s h")),
    "calibration": _hours(marked("The mounting is not ready %(hours)s h after the box was installed or moved")),
    "harsh": _harsh,
    "geofence": _fence,
    "theft": lambda facts: [(_THEFTS[facts["why"]], {})],
}


def mail_text(subject: Subject, delivery: AlertDelivery, public_url: str | None) -> str:
    """The body of an e-mail."""
    alert = subject.alert
    lines = [RECOVERED.get(alert.kind, "Over"), ""] if delivery.reason == "recovered" else []
    lines += [headline(subject), sentence(alert), "", f"When: {_moment(alert.at)}", f"Box: {subject.device.name}"]
    place = alert.facts.get("position")
    if place is not None:
        lines.append(f"Where: {place['lat_deg']:.6f}, {place['lon_deg']:.6f}")
    if alert.kind == "emergency":
        lines += _emergency_lines(alert.facts)
    if subject.rule is not None:
        lines.append(f"Rule: {subject.rule.name}")
    if public_url is not None:
        path = f"/events/{alert.event_id}" if alert.event_id else f"/alerts#alert-{alert.id}"
        lines += ["", public_url.rstrip("/") + path]
    return "\n".join(" ".join(line.split()) for line in lines) + "\n"


def _emergency_lines(facts: Mapping[str, Any]) -> list[str]:
    place, severity = facts["position"], facts["severity"]
    course = facts["course_deg"]
    lines = ["Where: not known"] if place is None else [f"Position: {_trust(place)}"]
    lines.append("Direction of travel: " + ("not known" if course is None else f"{course:.0f}° clockwise from north"))
    interval = severity["delta_v_interval95_kmh"]
    if interval is not None:
        lines.append(f"Delta-V, 95 % interval: {interval[0]:.0f} to {interval[1]:.0f} km/h")
    if severity["impact_speed_kmh"] is not None:
        lines.append(f"Speed before impact: {severity['impact_speed_kmh']:.0f} km/h")
    if severity["rollover"]:
        lines.append("The vehicle turned over")
    lines.append("Occupants: not known")
    if facts["delay_s"] > 60.0:
        lines.append(f"This became known {facts['delay_s'] / 60.0:.0f} min after the crash")
    lines.append("Not known: " + ", ".join(facts["not_known"]))
    return lines


def _trust(place: Mapping[str, Any]) -> str:
    if place["source"] == "trajectory":
        radius = place["radius95_m"]
        return "at the time of the crash" + ("" if radius is None else f", within {radius:.0f} m (95 %)")
    return f"of a fix {place['age_s']:.0f} s away from the crash"


def document(subject: Subject, delivery: AlertDelivery, public_url: str | None) -> bytes:
    """What a webhook gets."""
    alert, vehicle = subject.alert, subject.vehicle
    told = {
        "schema": SCHEMA,
        "delivery_id": delivery.id,
        "reason": delivery.reason,
        "alert": {
            "id": alert.id,
            "kind": alert.kind,
            "severity": alert.severity,
            "headline": headline(subject),
            "sentence": sentence(alert),
            "at": alert.at,
            "created_at": alert.created_at,
            "recovered_at": alert.recovered_at,
            "rule": None if subject.rule is None else {"id": subject.rule.id, "name": subject.rule.name},
            "device": {"id": subject.device.id, "name": subject.device.name},
            "vehicle": None
            if vehicle is None
            else {"id": vehicle.id, "name": vehicle.name, "plate": vehicle.plate, "class": vehicle.vehicle_class},
            "event_id": alert.event_id,
            "facts": alert.facts,
        },
        "url": None if public_url is None else f"{public_url.rstrip('/')}/alerts#alert-{alert.id}",
    }
    return orjson.dumps(told)


def tried_document(delivery_id: str) -> bytes:
    """What a webhook gets that somebody tries out."""
    return orjson.dumps({"schema": SCHEMA, "delivery_id": delivery_id, "reason": "test", "alert": None, "url": None})


TEST_SUBJECT = "Scatola: test message"
TEST_TEXT = "Somebody tried this channel. Alerts of your fleet will come here; there is nothing to do.\n"


def _moment(at: dt.datetime) -> str:
    return at.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
