"""What a round and a sweep tell: once, with the results, about the right vehicle, and that it is over."""

from __future__ import annotations

import dataclasses
import datetime as dt

import numpy as np
import pytest
from crash_world import Reconstructor, braking, crash
from fleet_world import CarriedWorld, Leg, cut, drive_of
from sqlalchemy import update

from server.alerts import service
from server.alerts.schemas import RuleIn, WebhookIn
from server.alerts.sweep import sweep
from server.alerts.webhook import Guard
from server.devices import provisioning
from server.formats.columns import Columns
from server.jobs.work import Round
from server.models import (
    Alert,
    AlertDelivery,
    Device,
    DeviceState,
    Diagnosis,
    Event,
    GeofencePresence,
    Organisation,
    TheftWatch,
)

pytestmark = pytest.mark.both_databases
T0 = 100.0
DRIVE = (Leg(100, 12.0), Leg(60, 0.0))
START = 1_772_366_400.0
EARTH = 111_195.08


class Fleet(CarriedWorld):
    """A world with rules and a channel."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self.channel_id = self.channel("ordinary")

    def channel(self, name, **more) -> str:
        wanted = WebhookIn(kind="webhook", name=name, url="https://hook.test/", **more)
        with self.database.transaction() as session:
            return service.add_channel(session, self.organisation.id, wanted, guard=Guard(), now=self.clock()).id

    def rule(self, condition, *, organisation_id=None, channels=None, **more) -> str:
        wanted = RuleIn(
            name=condition["kind"],
            condition=condition,
            channels=[self.channel_id] if channels is None else channels,
            **more,
        )
        with self.database.transaction() as session:
            return service.set_rule(session, organisation_id or self.organisation.id, None, wanted, now=self.clock())

    def send(self, drive, *, seconds=20.0, first=0, boot="boot", **columns) -> None:
        """Upload a drive batch by batch, each worked off before the next; constant columns beside it."""
        for k, batch in enumerate(cut(drive, seconds)):
            extra = {name: np.full(batch.rows, value) for name, value in columns.items()}
            self.put(Columns({**batch.values, **extra}), first + k, boot=boot)
            self.bring_up()

    def alerts(self, kind=None) -> list[Alert]:
        return [row for row in self.rows(Alert, Alert.at, Alert.id) if kind in (None, row.kind)]

    def owed(self, reason="raised") -> list[AlertDelivery]:
        return [row for row in self.rows(AlertDelivery, AlertDelivery.created_at) if row.reason == reason]


@pytest.fixture
def fleet(database, settings, clock, organisation) -> Fleet:
    return Fleet(database, settings, clock, organisation)


# --- crash and emergency


def test_a_crash_is_told_and_the_emergency_first(fleet):
    emergency = fleet.channel("emergency", emergency=True)
    rule = fleet.rule({"kind": "crash", "min_delta_v_kmh": 20.0})
    fleet.rule({"kind": "crash", "min_delta_v_kmh": 50.0})
    fleet.reconstructor = Reconstructor(crash(T0))
    fleet.send(drive_of(*DRIVE))
    event = fleet.one(Event)
    assert event.revision > 1  # context came, and told nobody anew
    (told,), (urgent,) = fleet.alerts("crash"), fleet.alerts("emergency")
    assert (told.rule_id, told.event_id, told.vehicle_id) == (rule, event.id, fleet.vehicle_id)
    assert told.facts["delta_v_kmh"] == pytest.approx(32.0)
    assert {(row.alert_id, row.channel_id, row.priority) for row in fleet.owed()} == {
        (told.id, fleet.channel_id, 1),
        (urgent.id, emergency, 0),
    }
    assert fleet.kinds().count("alert") == 2
    facts = urgent.facts
    assert facts["position"]["lat_deg"] == pytest.approx(41.9028, abs=1e-6)
    assert facts["position"]["source"] == "trajectory"
    assert facts["course_deg"] == pytest.approx(np.degrees(0.6), abs=0.1)
    assert facts["severity"]["pdof_clock"] == 11
    assert facts["occupants"] == "unknown"
    msd = facts["msd"]
    assert msd["vehicleLocation"]["positionLatitude"] == pytest.approx(41.9028 * 3_600_000, abs=4)
    assert msd["vehicleDirection"] == 17
    assert msd["timestamp"] == int(event.at.timestamp())
    assert msd["control"] == {
        "automaticActivation": True,
        "testCall": False,
        "positionCanBeTrusted": True,
        "vehicleType": "passengerVehicleClassM1",
    }
    # Five seconds before the crash, 62 m back along the way: north and east in steps of 100 mas (3.09 m).
    assert msd["recentVehicleLocationN1"]["latitudeDelta"] == pytest.approx(-60 * np.cos(0.57) / 3.09, abs=2)
    assert msd["numberOfOccupants"] is None
    assert set(facts["not_known"]) == {
        "numberOfOccupants",
        "vehicleIdentificationNumber",
        "vehiclePropulsionStorageType",
    }


def test_an_emergency_without_path_says_what_is_not_known(fleet):
    blind = dataclasses.replace(crash(T0), trajectory=None, pdof=None, delta_v=None, pulse=None)
    fleet.reconstructor = Reconstructor(blind)
    fleet.send(drive_of(*DRIVE))
    (urgent,) = fleet.alerts("emergency")
    facts = urgent.facts
    # The last fix that was known when the crash was found.
    assert facts["position"]["source"] == "last_fix"
    assert facts["position"]["age_s"] < 25.0
    assert facts["msd"]["control"]["positionCanBeTrusted"] is True
    assert {"delta_v_kmh", "pdof_deg"} <= set(facts["not_known"])


def test_a_crash_of_long_ago_is_no_emergency(fleet):
    fleet.rule({"kind": "crash"})
    fleet.reconstructor = Reconstructor(crash(T0))
    fleet.clock.advance(days=2)
    fleet.send(drive_of(*DRIVE))
    assert [row.kind for row in fleet.alerts()] == ["crash"]


def test_a_crash_that_later_data_deny_is_taken_back(fleet):
    fleet.channel("emergency", emergency=True)
    fleet.rule({"kind": "crash"})
    fleet.reconstructor = Reconstructor(crash(T0))
    batches = cut(drive_of(*DRIVE), 20.0)
    for k, batch in enumerate(batches[:6]):
        fleet.put(batch, k)
        fleet.bring_up()
    assert {row.recovered_at for row in fleet.alerts()} == {None}
    fleet.reconstructor.events = []
    fleet.put(batches[6], 6)
    fleet.bring_up()
    assert fleet.one(Event).withdrawn_at is not None
    assert {row.recovered_at for row in fleet.alerts()} == {fleet.clock()}
    assert len(fleet.owed("raised")) == len(fleet.owed("recovered")) == 2


def test_alerts_are_written_with_the_results_or_not_at_all(fleet, monkeypatch):
    fleet.rule({"kind": "crash"})
    fleet.reconstructor = Reconstructor(crash(T0))
    store = Round._store

    def killed(self, session):
        store(self, session)
        session.flush()
        raise ConnectionError("killed just before the commit")

    for k, batch in enumerate(cut(drive_of(*DRIVE), 20.0)):
        fleet.put(batch, k)
    monkeypatch.setattr(Round, "_store", killed)
    with pytest.raises(ConnectionError):
        fleet.bring_up()
    assert fleet.rows(Event) == fleet.alerts() == fleet.owed() == []
    monkeypatch.setattr(Round, "_store", store)
    fleet.bring_up()
    assert len(fleet.rows(Event)) == len(fleet.alerts("crash")) == len(fleet.alerts("emergency")) == 1
    assert len(fleet.owed()) == 1


def test_another_organisations_rules_and_channels_are_not_asked(fleet):
    with fleet.database.transaction() as session:
        other = Organisation(name="other", created_at=fleet.clock())
        session.add(other)
        session.flush()
        theirs = service.add_channel(
            session,
            other.id,
            WebhookIn(kind="webhook", name="x", url="https://hook.test/", emergency=True),
            guard=Guard(),
            now=fleet.clock(),
        ).id
        other_id = other.id
    fleet.rule({"kind": "crash"}, organisation_id=other_id, channels=[theirs])
    fleet.reconstructor = Reconstructor(crash(T0))
    fleet.send(drive_of(*DRIVE))
    assert [row.kind for row in fleet.alerts()] == ["emergency"]
    assert fleet.owed() == []


# --- moved, harsh


def test_a_moved_box_is_told_once(fleet):
    fleet.rule({"kind": "moved", "min_angle_deg": 10.0})
    fleet.send(drive_of(Leg(200, 12.0), Leg(200, 12.0, -1.0)), seconds=20.0)
    (told,) = fleet.alerts("moved")
    assert told.facts["angle_deg"] == pytest.approx(180.0)
    assert len(fleet.owed()) == 1


def test_harsh_driving_is_told_once_a_day(fleet):
    fleet.rule({"kind": "harsh", "count": 3})
    fleet.rule({"kind": "harsh", "count": 3, "per": "100km"})
    fleet.reconstructor = Reconstructor(*(braking(t) for t in (30.0, 50.0, 75.0, 95.0, 130.0)))
    fleet.send(drive_of(Leg(180, 20.0)))
    (told,) = fleet.alerts("harsh")
    # Not enough way for the rule by distance.
    assert told.facts["per"] == "day"
    assert told.facts["count"] == 3
    assert fleet.alerts("emergency") == []


def test_harsh_driving_per_distance(fleet):
    fleet.rule({"kind": "harsh", "count": 8, "per": "100km"})
    fleet.reconstructor = Reconstructor(*(braking(t) for t in (300.0, 590.0)))
    fleet.send(drive_of(Leg(700, 36.0), rate=5.0), seconds=100.0)
    (told,) = fleet.alerts("harsh")
    assert told.facts["count"] == 2
    assert 20.0 < told.facts["kilometres"] < 25.0


# --- geofence


def circle(metres_north, radius, **more):
    lat = 45.0 + metres_north / EARTH
    return {
        "kind": "geofence",
        "fence": {"shape": "circle", "lat_deg": lat, "lon_deg": 7.6, "radius_m": radius},
        **more,
    }


def test_entering_and_leaving_an_area(fleet):
    fleet.rule(circle(600.0, 200.0), cooldown_s=0.0)
    fleet.rule(circle(600.0, 200.0, on="leave"), cooldown_s=0.0)
    square = [[45.0 + n / EARTH, 7.6 + e] for n, e in ((300, -0.01), (300, 0.01), (900, 0.01), (900, -0.01))]
    fleet.rule({"kind": "geofence", "fence": {"shape": "polygon", "corners": square}, "on": "enter"}, cooldown_s=0.0)
    fleet.rule(circle(600.0, 200.0), cooldown_s=0.0, enabled=False)
    fleet.send(drive_of(Leg(100, 10.0)))
    found = [(row.facts["passage"], round(row.at.timestamp() - START)) for row in fleet.alerts()]
    # 400 m and 800 m at 10 m/s, 25 m past the edge; the square's edge is at 300 m.
    assert sorted(found) == [("entered", 33), ("entered", 43), ("left", 83), ("left", 83)]
    assert fleet.alerts()[0].facts["position"]["lon_deg"] == pytest.approx(7.6)
    assert len(fleet.rows(GeofencePresence)) == 3


def test_late_and_repeated_data_pass_no_fence_again(fleet):
    fleet.rule(circle(600.0, 200.0), cooldown_s=0.0)
    batches = cut(drive_of(Leg(100, 10.0)), 20.0)
    for k in (0, 1, 2, 4, 3):
        fleet.put(batches[k], k)
        fleet.bring_up()
    assert [row.facts["passage"] for row in fleet.alerts()] == ["entered", "left"]
    before = len(fleet.alerts())
    fleet.clock.advance(days=3)
    # A week-old drive out of the box's memory.
    fleet.send(drive_of(Leg(100, 10.0), utc=START - 7 * 86400.0), boot="old")
    assert len(fleet.alerts()) == before


def test_within_the_cool_down_it_is_counted(fleet):
    fleet.rule(circle(600.0, 200.0, on="enter"), cooldown_s=600.0)
    for k in range(3):
        fleet.send(drive_of(Leg(100, 10.0), utc=START + 100.0 * k), boot=f"boot-{k}")
        fleet.clock.advance(seconds=100)
    (told,) = fleet.alerts()
    assert told.repeats == 2
    assert len(fleet.owed()) == 1
    fleet.clock.advance(seconds=600)
    fleet.send(drive_of(Leg(100, 10.0), utc=START + 900.0), boot="later")
    assert len(fleet.owed()) == 2


def test_a_changed_fence_begins_anew(fleet):
    rule_id = fleet.rule(circle(0.0, 500.0), cooldown_s=0.0)
    fleet.send(drive_of(Leg(20, 10.0)))
    assert fleet.one(GeofencePresence).inside
    with fleet.database.transaction() as session:
        wanted = RuleIn(name="moved away", condition=circle(5000.0, 500.0), channels=[])
        service.set_rule(session, fleet.organisation.id, rule_id, wanted, now=fleet.clock())
    fleet.send(drive_of(Leg(20, 10.0), utc=START + 20.0), boot="next")
    assert fleet.alerts() == []
    assert not fleet.one(GeofencePresence).inside


# --- theft


def told_to_box(fleet):
    with fleet.database.reading() as session:
        return provisioning.told(session, fleet.device_id, None, now=fleet.clock())


def test_movement_without_ignition_is_theft(fleet):
    emergency = fleet.channel("emergency", emergency=True)
    fleet.rule({"kind": "theft"})
    fleet.send(drive_of(Leg(40, 12.0), Leg(20, 0.0)), ignition=1.0)
    assert fleet.alerts() == []
    fleet.send(drive_of(Leg(40, 0.0), Leg(40, 8.0), utc=START + 60.0), boot="towed", ignition=0.0)
    (told,) = fleet.alerts()
    assert told.kind == "theft"
    assert told.at.timestamp() == pytest.approx(START + 100.0, abs=1.5)
    assert told.facts["why"] == "moves without ignition"
    assert {row.channel_id for row in fleet.owed()} == {fleet.channel_id, emergency}
    assert {row.priority for row in fleet.owed()} == {0}
    assert fleet.one(TheftWatch).alarm_at == told.at
    (asked,) = told_to_box(fleet)
    assert (asked.kind, asked.period_s) == ("live", 5.0)
    # Ended by a person: the box is left alone, and whoever was told is told.
    with fleet.database.transaction() as session:
        service.arm(session, fleet.organisation.id, fleet.vehicle_id, armed=False, actor="Anna", now=fleet.clock())
    assert told_to_box(fleet) == []
    assert len(fleet.owed("recovered")) == 2
    fleet.clock.advance(hours=25)
    assert told_to_box(fleet) == []


def test_the_last_word_on_the_ignition_counts_where_data_say_nothing(fleet):
    fleet.rule({"kind": "theft"})
    fleet.send(drive_of(Leg(40, 0.0)), ignition=0.0)
    fleet.send(drive_of(Leg(20, 8.0), utc=START + 40.0), boot="next")
    assert len(fleet.alerts("theft")) == 1


def test_where_nobody_says_anything_of_the_ignition_nothing_is_theft(fleet):
    fleet.rule({"kind": "theft"})
    fleet.send(drive_of(Leg(60, 8.0)))
    assert fleet.alerts() == []
    assert "ignition" not in fleet.one(DeviceState).health


def test_armed_by_hand_any_movement_is_theft_and_a_jump_is_none(fleet):
    fleet.channel("emergency", emergency=True)
    with fleet.database.transaction() as session:
        service.arm(session, fleet.organisation.id, fleet.vehicle_id, armed=True, actor="Anna", now=fleet.clock())
    fleet.send(drive_of(Leg(30, 0.0), Leg(1, 9.0), Leg(29, 0.0), gnss_rate=1.0), ignition=1.0)
    assert fleet.alerts() == []
    fleet.send(drive_of(Leg(10, 9.0), utc=START + 60.0), boot="next", ignition=1.0)
    (told,) = fleet.alerts()
    assert (told.rule_id, told.facts["why"]) == (None, "moves although armed")
    assert len(fleet.owed()) == 1
    # As long as the alarm stands it is not told again.
    fleet.send(drive_of(Leg(60, 9.0), utc=START + 70.0), boot="on", ignition=1.0)
    assert len(fleet.alerts()) == 1


# --- silent, calibration


def test_a_silent_box_is_told_once_and_that_it_is_back(fleet, clock):
    fleet.rule({"kind": "silent", "hours": 24})
    fleet.send(drive_of(Leg(20, 10.0)))
    seen = fleet.rows(Device, Device.created_at)
    assert sum(row.last_seen_at is not None for row in seen) == 1  # the other one was never heard
    clock.advance(hours=23)
    assert sweep(fleet.database, clock=clock) == 0
    clock.advance(hours=2)
    assert sweep(fleet.database, clock=clock) == 1
    for _ in range(100):
        clock.advance(hours=1)
        assert sweep(fleet.database, clock=clock) == 0
    (told,) = fleet.alerts("silent")
    assert told.device_id == fleet.device_id
    assert len(fleet.owed()) == 1
    fleet.send(drive_of(Leg(20, 10.0), utc=clock().timestamp()), boot="back")
    assert sweep(fleet.database, clock=clock) == 1
    assert fleet.alerts("silent")[0].recovered_at == clock()
    assert len(fleet.owed("recovered")) == 1
    clock.advance(hours=25)
    assert sweep(fleet.database, clock=clock) == 1
    assert len(fleet.alerts("silent")) == 2


def test_a_revoked_box_is_not_silent(fleet, clock):
    fleet.rule({"kind": "silent", "hours": 1})
    fleet.send(drive_of(Leg(20, 10.0)))
    with fleet.database.transaction() as session:
        session.execute(update(Device).values(revoked_at=clock()))
    clock.advance(hours=2)
    assert sweep(fleet.database, clock=clock) == 0


def test_a_mounting_that_stays_unknown_is_told_and_that_it_is_ready(fleet, clock):
    fleet.rule({"kind": "calibration", "hours": 1})
    clock.advance(minutes=1)
    fleet.send(drive_of(Leg(40, 10.0)))
    clock.advance(hours=2)
    assert sweep(fleet.database, clock=clock) == 1
    assert sweep(fleet.database, clock=clock) == 0
    (told,) = fleet.alerts("calibration")
    assert told.facts["hours"] == 1.0
    fleet.send(drive_of(Leg(200, 10.0), utc=clock().timestamp()), boot="on")
    fleet.settle()
    assert sweep(fleet.database, clock=clock) == 1
    assert fleet.alerts("calibration")[0].recovered_at is not None


# --- diagnosis out of batches


def test_battery_temperature_and_ignition_are_kept_by_the_minute_where_they_change(fleet):
    drive = drive_of(Leg(300, 10.0))
    for k, batch in enumerate(cut(drive, 20.0)):
        t = batch.values["t"]
        extra = {"battery": np.where(t < 150.0, 12.6, 14.2), "temp": 20.0 + t / 600.0, "ignition": np.ones(t.size)}
        fleet.put(Columns({**batch.values, **extra}), k)
        fleet.bring_up()
    kept: dict[str, list] = {}
    for row in fleet.rows(Diagnosis, Diagnosis.name, Diagnosis.at):
        kept.setdefault(row.name, []).append((row.at - dt.datetime(2026, 3, 1, 12, tzinfo=dt.UTC), row.value))
    minute = dt.timedelta(minutes=1)
    assert kept["battery_v"] == [(0 * minute, 12.6), (2 * minute, 14.2)]
    assert kept["ignition"] == [(0 * minute, 1.0)]
    assert [at for at, _ in kept["temperature_c"]] == [0 * minute]
