"""An alert in words: subject, sentences, and the JSON of a webhook; other languages come from the catalogues."""

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
    "emergency": marked("Withdrawn: later data show no such crash"),
    "crash": marked("Withdrawn: later data show no such event"),
    "silent": marked("The box reports again"),
    "calibration": marked("The mounting is ready"),
    "theft": marked("The alarm was ended"),
}
OVER = marked("It is over")
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
Say = Callable[[str], str]
"""From a text of the catalogues to the same in a language."""


def english(text: str) -> str:
    """The text itself."""
    return text


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


def headline(subject: Subject, say: Say = english) -> str:
    """What and which vehicle."""
    return f"{say(KINDS[subject.alert.kind])}: {subject.name}"


def title(subject: Subject, reason: str, say: Say) -> str:
    """Subject of a mail."""
    if reason != "recovered":
        return headline(subject, say)
    return f"{say(RECOVERED.get(subject.alert.kind, OVER))}: {subject.name}"


def sentence(alert: Alert, say: Say = english) -> str:
    """What happened, in one line, without a place."""
    return ", ".join(say(pattern) % values for pattern, values in parts(alert))


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


def mail_text(subject: Subject, delivery: AlertDelivery, public_url: str | None, say: Say = english) -> str:
    """The body of an e-mail, in one language."""
    alert = subject.alert
    told: list[Part] = [
        (marked("When: %(at)s UTC"), {"at": alert.at.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M:%S")}),
        (marked("Box: %(name)s"), {"name": subject.device.name}),
    ]
    place = alert.facts.get("position")
    if place is not None:
        values = {"lat": f"{place['lat_deg']:.6f}", "lon": f"{place['lon_deg']:.6f}"}
        told.append((marked("Where: %(lat)s, %(lon)s"), values))
    if alert.kind == "emergency":
        told += _emergency_lines(alert.facts)
    if subject.rule is not None:
        told.append((marked("Rule: %(name)s"), {"name": subject.rule.name}))
    lines = [say(RECOVERED.get(alert.kind, OVER)), ""] if delivery.reason == "recovered" else []
    lines += [headline(subject, say), sentence(alert, say), "", *(say(pattern) % values for pattern, values in told)]
    if public_url is not None:
        path = f"/events/{alert.event_id}" if alert.event_id else f"/alerts#alert-{alert.id}"
        lines += ["", public_url.rstrip("/") + path]
    return "\n".join(" ".join(line.split()) for line in lines) + "\n"


def _emergency_lines(facts: Mapping[str, Any]) -> list[Part]:
    place, severity = facts["position"], facts["severity"]
    course, interval, speed = facts["course_deg"], severity["delta_v_interval95_kmh"], severity["impact_speed_kmh"]
    lines: list[Part] = [(marked("Where: not known"), {}) if place is None else _trust(place)]
    if course is None:
        lines.append((marked("Direction of travel: not known"), {}))
    else:
        lines.append((marked("Direction of travel: %(course)s° clockwise from north"), {"course": f"{course:.0f}"}))
    if interval is not None:
        values = {"low": f"{interval[0]:.0f}", "high": f"{interval[1]:.0f}"}
        lines.append((marked("Delta-V, 95 %% interval: %(low)s to %(high)s km/h"), values))
    if speed is not None:
        lines.append((marked("Speed before impact: %(speed)s km/h"), {"speed": f"{speed:.0f}"}))
    if severity["rollover"]:
        lines.append((marked("The vehicle turned over"), {}))
    lines.append((marked("Occupants: not known"), {}))
    if facts["delay_s"] > 60.0:
        values = {"minutes": f"{facts['delay_s'] / 60.0:.0f}"}
        lines.append((marked("This became known %(minutes)s min after the crash"), values))
    lines.append((marked("Not known: %(names)s"), {"names": ", ".join(facts["not_known"])}))
    return lines


def _trust(place: Mapping[str, Any]) -> Part:
    if place["source"] != "trajectory":
        return marked("Position: of a fix %(age)s s away from the crash"), {"age": f"{place['age_s']:.0f}"}
    radius = place["radius95_m"]
    if radius is None:
        return marked("Position: at the time of the crash"), {}
    return marked("Position: at the time of the crash, within %(radius)s m (95 %%)"), {"radius": f"{radius:.0f}"}


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


TEST_SUBJECT = marked("Scatola: test message")
TEST_TEXT = marked("Somebody tried this channel. Alerts of your fleet will come here; there is nothing to do.")
