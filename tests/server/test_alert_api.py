"""Alerts, diagnosis, statistics, style, contradictions and claims over HTTP."""

from __future__ import annotations

import datetime as dt
import struct
from zoneinfo import ZoneInfo

import pytest
import sqlalchemy as sa
from crash_world import crash, store_event
from fleet_world import CarriedWorld, Leg, cut, drive_of
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from nav_core.records import Drive, Inertial
from server.formats import codec8e
from server.formats.columns import Columns
from server.models import (
    Alert,
    AlertChannel,
    Assignment,
    AuditEntry,
    Batch,
    BatchDigest,
    Boot,
    Device,
    Diagnosis,
    Event,
    Installation,
    TheftWatch,
    Trip,
    new_id,
)
from server.statistics.queries import night_s
from server.statistics.score import MIN_KM, poisson_interval95, score_of

both = pytest.mark.both_databases
AT = dt.datetime(2026, 3, 1, 12, 0, tzinfo=dt.UTC)


@pytest.fixture
def vehicle_id(admin) -> str:
    return admin.post("/api/v1/vehicles", json={"name": "Panda"}).json()["id"]


# --- rules, channels, acknowledging


@both
def test_rules_and_channels_are_made_changed_and_removed(admin, database, vehicle_id):
    channel = admin.post(
        "/api/v1/alert-channels", json={"kind": "webhook", "name": "ours", "url": "https://example.org/x"}
    )
    assert channel.status_code == 201
    made = channel.json()
    assert made["secret"].startswith("scw_")
    assert "secret" not in admin.get(f"/api/v1/alert-channels/{made['id']}").json()
    again = admin.post(f"/api/v1/alert-channels/{made['id']}/secret").json()
    assert again["secret"] != made["secret"]
    rule = admin.post(
        "/api/v1/alert-rules",
        json={
            "name": "yard",
            "vehicle_id": vehicle_id,
            "channels": [made["id"]],
            "condition": {
                "kind": "geofence",
                "fence": {"shape": "polygon", "corners": [[45.0, 7.0], [45.1, 7.0], [45.0, 7.1]]},
            },
        },
    )
    assert rule.status_code == 201, rule.text
    told = rule.json()
    assert (told["cooldown_s"], told["condition"]["on"], told["condition"]["margin_m"]) == (300.0, "both", 25.0)
    path = f"/api/v1/alert-rules/{told['id']}"
    other = admin.put(path, json={"name": "x", "condition": {"kind": "crash"}})
    assert (other.status_code, other.json()["code"]) == (409, "rule_kind")
    changed = admin.put(path, json={**{k: told[k] for k in ("name", "condition", "channels")}, "enabled": False})
    assert changed.json()["enabled"] is False
    assert admin.delete(f"/api/v1/alert-channels/{made['id']}").status_code == 204
    assert admin.get(path).json()["channels"] == []
    assert admin.delete(path).status_code == 204
    assert admin.get(path).status_code == 404
    with database.reading() as session:
        actions = session.scalars(sa.select(AuditEntry.action).order_by(AuditEntry.id)).all()
        assert [each for each in actions if each.startswith("channel")] == [
            "channel.added",
            "channel.secret",
            "channel.removed",
        ]
        assert made["secret"] not in str([row.detail for row in session.scalars(sa.select(AuditEntry))])
        assert session.scalars(sa.select(AlertChannel)).all() == []


@pytest.mark.parametrize(
    ("condition", "word"),
    [
        ({"kind": "nothing"}, "kind"),
        ({"kind": "silent", "hours": 0}, "hours"),
        ({"kind": "crash", "min_delta_v_kmh": -1}, "min_delta_v_kmh"),
        ({"kind": "geofence", "fence": {"shape": "circle", "lat_deg": 45, "lon_deg": 7, "radius_m": 0}}, "circle"),
        ({"kind": "geofence", "fence": {"shape": "circle", "lat_deg": 95, "lon_deg": 7, "radius_m": 9}}, "circle"),
        (
            {
                "kind": "geofence",
                "fence": {"shape": "polygon", "corners": [[0, 0], [1e-1, 1e-1], [1e-1, 0], [0, 1e-1]]},
            },
            "crosses",
        ),
        ({"kind": "harsh", "per": "week"}, "per"),
    ],
)
def test_conditions_that_mean_nothing_are_refused(admin, condition, word):
    answer = admin.post("/api/v1/alert-rules", json={"name": "x", "condition": condition})
    assert answer.status_code == 422
    assert word in answer.text


@pytest.mark.parametrize(
    "channel",
    [
        {"kind": "webhook", "name": "x", "url": "http://example.org/"},
        {"kind": "webhook", "name": "x", "url": "https://127.0.0.1/"},
        {"kind": "webhook", "name": "x", "url": "https://[::1]/"},
        {"kind": "email", "name": "x", "recipients": []},
        {"kind": "email", "name": "x", "recipients": ["a@b.cc\r\nBcc: d@e.ff"]},
        {"kind": "email", "name": "x", "recipients": ["a@b.cc, d@e.ff"]},
        {"kind": "email", "name": "x", "recipients": ["nobody"]},
        {"kind": "pigeon", "name": "x"},
    ],
)
def test_channels_that_lead_nowhere_good_are_refused(admin, channel):
    assert admin.post("/api/v1/alert-channels", json=channel).status_code == 422


def add_alert(session, organisation_id, device_id, at, **more) -> str:
    row = Alert(
        id=new_id(),
        organisation_id=organisation_id,
        kind="silent",
        severity="attention",
        occurrence=new_id(),
        device_id=device_id,
        at=at,
        created_at=at,
        facts={"hours": 24.0},
        **more,
    )
    session.add(row)
    return row.id


@both
def test_alerts_are_listed_a_page_at_a_time_and_acknowledged_once(admin, database, organisation, make_device):
    device_id, _ = make_device()
    with database.transaction() as session:
        ids = [add_alert(session, organisation.id, device_id, AT + dt.timedelta(minutes=k)) for k in range(5)]
    first = admin.get("/api/v1/alerts", params={"limit": 3}).json()
    rest = admin.get("/api/v1/alerts", params={"limit": 3, "before": first["next"]}).json()
    assert [each["id"] for each in first["items"] + rest["items"]] == ids[::-1]
    assert rest["next"] is None
    done = admin.post(f"/api/v1/alerts/{ids[0]}/acknowledge").json()
    assert done["acknowledged_by"] == "administrator's token"
    again = admin.post(f"/api/v1/alerts/{ids[0]}/acknowledge").json()
    assert again["acknowledged_at"] == done["acknowledged_at"]
    waiting = admin.get("/api/v1/alerts", params={"waiting": True}).json()["items"]
    assert ids[0] not in [each["id"] for each in waiting]
    assert admin.get("/api/v1/alerts", params={"before": "x"}).status_code == 422


# --- theft mode


@both
def test_a_box_is_asked_to_report_often_while_its_vehicle_is_stolen(admin, client, database, make_device, vehicle_id):
    _, token = make_device(vehicle_id=vehicle_id)
    armed = admin.put(f"/api/v1/vehicles/{vehicle_id}/theft", json={"armed": True}).json()
    assert (armed["armed_by"], armed["armed_by_ignition"], armed["alarm_at"]) == ("administrator's token", False, None)

    def upload(sequence):
        body = {"columns": {"t": [float(sequence)], "fx": [0.0], "fy": [0.0], "fz": [-9.8]}}
        headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": f"b/{sequence}"}
        return client.post("/api/v1/batches", json=body, headers=headers).json()["requests"]

    assert upload(0) == []
    with database.transaction() as session:
        session.get_one(TheftWatch, vehicle_id).alarm_at = AT
    (asked,) = upload(1)
    assert (asked["kind"], asked["period_s"]) == ("live", 5.0)
    assert client.get("/api/v1/device", headers={"Authorization": f"Bearer {token}"}).json()["requests"] == [asked]
    assert admin.put(f"/api/v1/vehicles/{vehicle_id}/theft", json={"armed": False}).json()["alarm_at"] is None
    assert upload(2) == []


# --- diagnosis


@both
def test_a_box_tells_named_values(admin, client, make_device, clock):
    device_id, token = make_device()
    bearer = {"Authorization": f"Bearer {token}"}
    values = [
        {"name": "obd.rpm", "value": 800.0, "age_s": 300.0},
        {"name": "obd.rpm", "value": 800.0, "age_s": 200.0},
        {"name": "obd.rpm", "value": 2100.0, "age_s": 100.0},
        {"name": "battery_v", "value": 12.4, "at": AT.isoformat()},
    ]
    path = "/api/v1/device/diagnosis"
    assert client.post(path, json={"values": values}, headers=bearer).json() == {"kept": 3}
    assert client.post(path, json={"values": values}, headers=bearer).json() == {"kept": 0}
    clock.advance(hours=2)
    later = [{"name": "obd.rpm", "value": 2100.0}]
    assert client.post(path, json={"values": later}, headers=bearer).json() == {"kept": 1}
    told = admin.get(f"/api/v1/devices/{device_id}/diagnosis", params={"name": ["obd.rpm", "other"]}).json()
    assert [(each["name"], each["value"], each["unit"]) for each in told["latest"]] == [
        ("battery_v", 12.4, "V"),
        ("obd.rpm", 2100.0, None),
    ]
    assert [each["value"] for each in told["series"]["obd.rpm"]] == [800.0, 2100.0, 2100.0]
    assert told["series"]["other"] == []
    for bad in (
        {"values": []},
        {"values": [{"name": "No Spaces", "value": 1.0}]},
        {"values": [{"name": "x", "value": 1e300}]},
        {"values": [{"name": "x", "value": 1.0, "at": "9999-12-31T23:59:59-12:00"}]},
    ):
        assert client.post(path, json=bad, headers=bearer).status_code == 422
    nan = client.post(path, content=b'{"values":[{"name":"x","value":NaN}]}', headers=bearer)
    assert nan.status_code == 422
    assert admin.post(path, json={"values": values}).status_code == 403


def codec8e_packet(records: list[dict[int, int]], begin_ms: int) -> bytes:
    body = b""
    for k, numbers in enumerate(records):
        body += struct.pack(">QBiihHBH", begin_ms + 60_000 * k, 1, 76_000_000, 450_000_000, 240, 90, 9, 50)
        body += struct.pack(">HHHHH", 0, len(numbers), 0, len(numbers), 0)[:4]
        body += struct.pack(">H", 0) + struct.pack(">H", len(numbers))
        body += b"".join(struct.pack(">HH", name, value) for name, value in numbers.items())
        body += struct.pack(">HHH", 0, 0, 0)
    data = bytes([0x8E, len(records)]) + body + bytes([len(records)])
    return bytes(4) + struct.pack(">I", len(data)) + data + struct.pack(">I", codec8e._crc16(memoryview(data)))


@both
def test_inputs_of_codec_8e_that_have_no_column_become_diagnosis_values(client, admin, make_device, clock):
    device_id, token = make_device()
    records = [{66: 12_300, 113: 80, 9: 512}, {66: 12_300, 113: 79, 9: 512}, {66: 12_300, 113: 79, 9: 512}]
    body = codec8e_packet(records, int(clock().timestamp() - 300) * 1000)
    headers = {
        "Authorization": f"Bearer {token}",
        "Idempotency-Key": "b/0",
        "Content-Type": "application/vnd.scatola.codec8e",
    }
    answer = client.post("/api/v1/batches", content=body, headers=headers)
    assert answer.status_code == 202, answer.text
    told = admin.get(f"/api/v1/devices/{device_id}/diagnosis", params={"name": ["avl.113", "avl.9"]}).json()
    assert [each["value"] for each in told["series"]["avl.113"]] == [80.0, 79.0]
    assert [each["value"] for each in told["series"]["avl.9"]] == [512.0]
    # The supply has a column of its own, and is not hashed differently for what stands beside it.
    assert {each["name"] for each in told["latest"]} == {"avl.113", "avl.9"}
    columns = codec8e.read(body, max_decoded_bytes=None)
    assert columns.column_sha256() == Columns(dict(columns.values)).column_sha256()


# --- statistics and style


def add_trip(session, organisation_id, device_id, vehicle_id, began_at, minutes, km, moving_s=None, top=20.0):
    session.add(
        Trip(
            organisation_id=organisation_id,
            device_id=device_id,
            vehicle_id=vehicle_id,
            boot="b",
            t_first_s=0.0,
            t_last_s=60.0 * minutes,
            began_at=began_at,
            ended_at=began_at + dt.timedelta(minutes=minutes),
            under_way=False,
            distance_m=1000.0 * km,
            position_distance_m=1000.0 * km,
            moving_s=60.0 * minutes if moving_s is None else moving_s,
            max_speed_mps=top,
            algorithm="x",
            input_sha256="",
        )
    )


@both
def test_statistics_by_day_and_week(admin, database, organisation, make_device, vehicle_id, clock):
    device_id, _ = make_device(vehicle_id=vehicle_id)
    with database.transaction() as session:
        for at, minutes, km in (
            (AT - dt.timedelta(days=1), 60, 50.0),  # Saturday 28 February, noon
            (AT - dt.timedelta(days=1, hours=-9), 120, 100.0),  # 21:00 to 23:00: half of it night
            (AT - dt.timedelta(days=7), 30, 20.0),
        ):
            add_trip(session, organisation.id, device_id, vehicle_id, at, minutes, km, moving_s=45.0 * minutes)
    clock.advance(hours=1)
    told = admin.get("/api/v1/statistics", params={"vehicle": vehicle_id}).json()
    saturday, before = told["items"]
    assert (saturday["begins"], saturday["trips"]) == ("2026-02-28", 2)
    assert saturday["distance_m"] == 150_000.0
    assert saturday["moving_s"] == 45.0 * 180
    assert saturday["idle_s"] == 15.0 * 180
    assert saturday["night_share"] == pytest.approx(60.0 / 180.0)
    assert saturday["max_speed_kmh"] == 72.0
    assert before["begins"] == "2026-02-22"
    weeks = admin.get("/api/v1/statistics", params={"group": "week"}).json()["items"]
    assert [(each["begins"], each["trips"]) for each in weeks] == [("2026-02-23", 2), ("2026-02-16", 1)]
    # At 21:00 UTC it is already the next day in Tokyo.
    tokyo = admin.get("/api/v1/statistics", params={"zone": "Asia/Tokyo"}).json()["items"]
    assert [each["begins"] for each in tokyo] == ["2026-03-01", "2026-02-28", "2026-02-22"]
    for zone in ("Mars/Base", "../../etc/passwd", "", "Europe"):
        assert admin.get("/api/v1/statistics", params={"zone": zone}).status_code == 422, zone


@given(
    st.integers(0, 365 * 86400).map(lambda seconds: AT + dt.timedelta(seconds=seconds)),
    st.integers(0, 3 * 86400),
    st.sampled_from(["UTC", "Europe/Rome", "America/New_York", "Asia/Kolkata"]),
)
def test_night_agrees_with_counting_minutes(began_at, seconds, zone):
    local = ZoneInfo(zone)
    ended_at = began_at + dt.timedelta(seconds=seconds)
    clock = (began_at + dt.timedelta(seconds=60 * k + 30) for k in range(seconds // 60))
    counted = sum((at.astimezone(local).hour >= 22) or (at.astimezone(local).hour < 5) for at in clock)
    # Counted minutes that hold an edge of the night are half right, three nights at most.
    assert night_s(began_at, ended_at, local) == pytest.approx(60.0 * counted, abs=60.0 * 9)


@given(st.integers(0, 3000))
def test_the_poisson_interval_is_the_exact_one(count):
    low, high = poisson_interval95(count)
    assert low == pytest.approx(0.0 if count == 0 else stats.chi2.ppf(0.025, 2 * count) / 2.0, rel=1e-8)
    assert high == pytest.approx(stats.chi2.ppf(0.975, 2 * count + 2) / 2.0, rel=1e-8)


@given(st.integers(0, 1000), st.floats(MIN_KM, 1e6))
def test_a_score_lies_in_its_interval_and_falls_with_events(count, kilometres):
    found, worse = score_of(count, kilometres), score_of(count + 1, kilometres)
    low, high = found.score_interval95
    assert 0.0 <= low <= found.score <= high <= 100.0
    assert worse.score < found.score
    assert score_of(count, MIN_KM - 0.1).score is None


@both
def test_style_from_events_and_distance(admin, database, organisation, make_device, vehicle_id):
    device_id, _ = make_device(vehicle_id=vehicle_id)
    path = f"/api/v1/vehicles/{vehicle_id}/score"
    with database.transaction() as session:
        add_trip(session, organisation.id, device_id, vehicle_id, AT - dt.timedelta(hours=2), 60, 80.0)
        for k, kind in enumerate(["harsh_braking"] * 4 + ["harsh_cornering"] * 2 + ["crash"]):
            session.add(
                Event(
                    organisation_id=organisation.id,
                    device_id=device_id,
                    vehicle_id=vehicle_id,
                    boot="b",
                    kind=kind,
                    severe=kind == "crash",
                    t0_s=float(k),
                    t_end_s=float(k),
                    at=AT - dt.timedelta(minutes=k + 1),
                    created_at=AT,
                    updated_at=AT,
                    revision=1,
                    result={},
                    verdict="false_alarm" if k == 0 else None,
                )
            )
    told = admin.get(path).json()
    assert (told["status"], told["score"], told["events"]) == ("not_enough_distance", None, 5)
    with database.transaction() as session:
        add_trip(session, organisation.id, device_id, vehicle_id, AT - dt.timedelta(days=2), 60, 20.0)
    told = admin.get(path).json()
    assert told["by_kind"] == {"harsh_braking": 3, "harsh_acceleration": 0, "harsh_cornering": 2}
    assert told["per_100_km"] == pytest.approx(5.0)
    assert told["score"] == pytest.approx(50.0)
    low, high = told["per_100_km_interval95"]
    assert told["score_interval95"] == pytest.approx([100 * 2 ** (-high / 5), 100 * 2 ** (-low / 5)])
    assert "2^(-rate/5)" in told["formula"]


# --- contradictions and claims


class Scene(CarriedWorld):
    """A drive with a crash on it."""

    def drive(self, *legs, skip=(), **more):
        for k, batch in enumerate(cut(drive_of(*legs, **more), 20.0)):
            if k not in skip:
                self.put(batch, k, boot=more.get("boot", "boot"))
        while self.bring_up().more:
            pass

    def event(self, t0=100.0):
        with self.database.transaction() as session:
            device = session.get_one(Device, self.device_id)
            boot = session.get_one(Boot, (self.device_id, "boot"))
            installation = session.scalars(sa.select(Installation).order_by(Installation.began_at)).first()
            batches = list(session.scalars(sa.select(Batch).order_by(Batch.chain_index)))[:3]
            return store_event(session, crash(t0), device, boot, batches, installation, id=new_id()).id

    def change(self, statement):
        with self.database.transaction() as session:
            session.execute(statement)


@pytest.fixture
def scene(database, settings, clock, organisation) -> Scene:
    return Scene(database, settings, clock, organisation)


def codes(admin, event_id) -> dict[str, str]:
    told = admin.get(f"/api/v1/events/{event_id}/contradictions").json()
    assert {each["code"] for each in told["items"]} <= set(told["checked"])
    return {each["code"]: each["weight"] for each in told["items"]}


@both
def test_nothing_stands_against_a_clean_event(admin, scene):
    scene.drive(Leg(300, 12.0))
    assert codes(admin, scene.event()) == {}


@both
def test_what_stands_against_an_event_is_listed(admin, scene):
    scene.drive(Leg(300, 12.0), skip=(3, 8))
    event_id = scene.event()
    assert codes(admin, event_id) == {"gap_around": "doubt", "batches_missing": "doubt"}
    third = sa.select(Batch.id).order_by(Batch.chain_index).offset(2).limit(1).scalar_subquery()
    scene.change(sa.update(Batch).where(Batch.id == third).values(failure="cannot be decoded"))
    scene.change(sa.update(BatchDigest).where(BatchDigest.batch_id == third).values(clock_offset_s=1.772e9))
    scene.change(sa.update(Installation).values(beginning="moved", moved_angle_rad=1.0))
    scene.change(sa.update(Boot).values(utc_source="arrival", utc_sigma_s=30.0))
    found = codes(admin, event_id)
    assert found["unreadable_data"] == "grave"
    assert found["clock_jump"] == "doubt"
    assert found["box_moved_before"] == "doubt"
    assert found["clock_unsure"] == "note"
    assert "chain_broken" not in found
    scene.change(sa.update(Batch).where(Batch.id == third).values(body_sha256="0" * 64))
    assert codes(admin, event_id)["chain_broken"] == "grave"


@both
def test_a_deleted_link_and_a_late_start_are_found(admin, scene):
    scene.drive(Leg(300, 12.0))
    event_id = scene.event(t0=30.0)
    assert codes(admin, event_id) == {"silent_before": "doubt"}
    gone = sa.select(Batch.id).order_by(Batch.chain_index).offset(5).limit(1).scalar_subquery()
    scene.change(sa.delete(BatchDigest).where(BatchDigest.batch_id == gone))
    scene.change(sa.delete(Batch).where(Batch.chain_index == 5))
    assert codes(admin, event_id)["chain_broken"] == "grave"


@both
def test_distances_that_disagree_and_a_second_clock(admin, scene):
    scene.drive(Leg(300, 12.0))
    event_id = scene.event()
    scene.change(sa.update(Trip).values(distance_m=9000.0, position_distance_m=3000.0))
    with scene.database.transaction() as session:
        boot = session.get_one(Boot, (scene.device_id, "boot"))
        session.add(
            Boot(
                device_id=scene.device_id,
                boot="forged",
                ordinal=1,
                utc_offset_s=boot.utc_offset_s,
                utc_sigma_s=0.3,
                utc_source="gnss",
                arrival_offset_s=0.0,
                t_first_s=0.0,
                t_last_s=300.0,
            )
        )
    assert codes(admin, event_id) == {"clock_jump": "grave", "distance_disagrees": "doubt"}


def window(first_s, last_s):
    start = dt.datetime.fromtimestamp(1_772_366_400.0, dt.UTC)
    return {
        "from": (start + dt.timedelta(seconds=first_s)).isoformat(),
        "to": (start + dt.timedelta(seconds=last_s)).isoformat(),
    }


def claim(admin, scene, first_s, last_s, **more):
    body = {"vehicle_id": scene.vehicle_id, "reference": "C-1", **window(first_s, last_s), **more}
    answer = admin.post("/api/v1/accident-claims", json=body)
    assert answer.status_code == 201, answer.text
    return answer.json()


def assigned_from_the_beginning(scene):
    scene.change(sa.update(Assignment).values(began_at=scene.clock() - dt.timedelta(days=1)))


@both
def test_a_claim_without_a_pulse_gets_a_bound(admin, scene, database):
    assigned_from_the_beginning(scene)
    scene.drive(Leg(300, 12.0), rate=100.0)
    told = claim(admin, scene, 50.0, 250.0, direction_deg=0.0)
    answer = told["answer"]
    assert answer["verdict"] == "no_pulse"
    assert answer["covered_share"] == pytest.approx(1.0)
    bound = answer["bound"]
    # Noise of 0.05 m/s² moves it by centimetres per second; what is left is what gravity may hide.
    assert 3.6 * 0.15 < bound["max_delta_v_kmh"] < 0.8
    assert (bound["window_s"], bound["reliable"]) == (0.3, True)
    assert bound["sample_rate_hz"] == pytest.approx(100.0, rel=1e-3)
    assert f"above {bound['max_delta_v_kmh']:.1f} km/h" in answer["says"]
    assert admin.get(f"/api/v1/accident-claims/{told['id']}").json() == told
    assert admin.get("/api/v1/accident-claims", params={"vehicle": scene.vehicle_id}).json() == [told]
    with database.reading() as session:
        assert "claim.registered" in session.scalars(sa.select(AuditEntry.action)).all()
    assert admin.delete(f"/api/v1/vehicles/{scene.vehicle_id}").status_code == 409


def with_blow(drive: Drive, at: float, delta_v: float, duration: float, axis: int) -> Drive:
    t, f = drive.inertial.t, drive.inertial.f.copy()
    f[(t >= at) & (t < at + duration), axis] += delta_v / duration
    return Drive(Inertial(t, f), drive.gnss)


@pytest.mark.parametrize("duration", [0.03, 0.12, 0.25])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_bound_holds_what_was_there(admin, scene, duration, axis):
    assigned_from_the_beginning(scene)
    drive = with_blow(drive_of(Leg(120, 12.0), rate=100.0), 60.0, 5.0, duration, axis)
    for k, batch in enumerate(cut(drive, 20.0)):
        scene.put(batch, k)
    scene.bring_up()
    bound = claim(admin, scene, 10.0, 110.0)["answer"]["bound"]
    assert 3.6 * 5.0 <= bound["max_delta_v_kmh"] < 3.6 * 5.0 * 1.1 + 1.0
    at = dt.datetime.fromisoformat(bound["at"]).timestamp() - 1_772_366_400.0
    assert 59.6 < at < 60.3
    assert bound["peak_g"] == pytest.approx(5.0 / duration / 9.80665, rel=0.1)


@both
def test_a_claim_where_data_are_missing_says_so(admin, scene):
    assigned_from_the_beginning(scene)
    scene.drive(Leg(300, 12.0), skip=(5,))
    answer = claim(admin, scene, 50.0, 250.0)["answer"]
    assert answer["verdict"] == "not_covered"
    assert answer["covered_share"] == pytest.approx(0.9, abs=0.01)
    assert len(answer["gaps"]) == 1
    # 20 samples a second are too few for a short pulse.
    assert not answer["bound"]["reliable"]
    assert claim(admin, scene, 2000.0, 2100.0)["answer"]["verdict"] == "no_data"


@both
def test_a_claim_with_a_pulse_is_compared_with_it(admin, scene):
    assigned_from_the_beginning(scene)
    scene.drive(Leg(300, 12.0))
    event_id = scene.event()
    for direction, wanted in ((0.0, "agrees"), (-50.0, "agrees"), (90.0, "disagrees"), (180.0, "disagrees")):
        answer = claim(admin, scene, 80.0, 150.0, direction_deg=direction)["answer"]
        assert answer["verdict"] == "pulse_found"
        assert [each["direction"] for each in answer["pulses"]] == [wanted]
    assert codes(admin, event_id) == {"claim_disagrees": "doubt"}
    assert claim(admin, scene, 80.0, 150.0)["answer"]["pulses"][0]["direction"] == "not_known"


def test_windows_that_are_none_are_refused(admin, scene):
    for first, last in ((10.0, 10.0), (10.0, 5.0), (0.0, 7 * 3600.0)):
        body = {"vehicle_id": scene.vehicle_id, "reference": "x", **window(first, last)}
        assert admin.post("/api/v1/accident-claims", json=body).status_code == 422
    for begin in ("0001-01-01T00:00:10Z", "9999-12-31T20:00:00Z"):
        extreme = {"from": begin, "to": begin.replace("00:00:10", "01:00:00").replace("T20", "T23")}
        body = {"vehicle_id": scene.vehicle_id, "reference": "x", **extreme}
        assert admin.post("/api/v1/accident-claims", json=body).status_code == 422
    extreme = {"from": "0001-01-01T00:00:00+14:00", "to": "0001-01-01T01:00:00+14:00"}
    body = {"vehicle_id": scene.vehicle_id, "reference": "x", **extreme}
    assert admin.post("/api/v1/accident-claims", json=body).status_code == 422


MINUTE = dt.timedelta(minutes=1)


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 2)), max_size=30))
def test_the_curve_through_what_is_kept_is_the_curve_through_what_was_read(pairs):
    import sqlite3

    from sqlalchemy.orm import Session

    from server.diagnosis.service import Reading, keep

    values = dict(pairs)
    engine = sa.create_engine("sqlite://", creator=lambda: sqlite3.connect(":memory:"))
    with engine.connect() as connection, Session(connection) as session:
        Diagnosis.__table__.create(connection)
        for minute, value in sorted(values.items()):
            keep(session, "d" * 32, [Reading("x", AT + minute * MINUTE, float(value))], now=AT + 60 * MINUTE)
        again = [Reading("x", AT + minute * MINUTE, float(value)) for minute, value in values.items()]
        assert keep(session, "d" * 32, again, now=AT + 60 * MINUTE) == 0
        kept = {row.at: row.value for row in session.scalars(sa.select(Diagnosis))}
    engine.dispose()
    for minute, value in values.items():
        last = max((at for at in kept if at <= AT + minute * MINUTE), default=None)
        assert last is not None
        assert kept[last] == value
