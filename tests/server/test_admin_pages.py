"""The administration's pages and their forms over HTTP, and what the audit log says of them."""

from __future__ import annotations

import csv
import datetime as dt
import io
import re

import pytest
import sqlalchemy as sa
from test_tenants import tenants

from server.alerts.webhook import Answer
from server.models import (
    AlertChannel,
    AlertRule,
    AuditEntry,
    ClaimCode,
    Device,
    Event,
    EventRevision,
    JobFailure,
    Rerun,
    Trip,
    Vehicle,
)
from server.pages.admin_alerts import _as_typed, _fields
from server.pages.frame import MEASURES

__all__ = ["tenants"]

PAGES = ("", "/boxes", "/boxes?show=silent", "/boxes?show=full", "/boxes?show=revoked", "/boxes?q=box+of")
PAGES += ("/alerts", "/alerts/channels/new?kind=webhook", "/work", "/versions")
PAGES += tuple(
    f"/alerts/rules/new?kind={kind}"
    for kind in ("crash", "moved", "silent", "calibration", "harsh", "geofence", "theft")
)


def actions(database) -> list[str]:
    with database.reading() as session:
        return list(session.scalars(sa.select(AuditEntry.action).order_by(AuditEntry.id)))


def secret_in(page: str) -> str:
    found = re.search(r'class="secret">([^<]+)<', page)
    assert found is not None
    return found[1]


@pytest.mark.both_databases
@pytest.mark.parametrize("language", ["en", "it"])
def test_every_page_answers_in_both_languages(admin, tenants, language):
    mine = tenants.mine
    own = [f"/boxes/{mine['device']}", f"/alerts/rules/{mine['rule']}", f"/alerts/channels/{mine['channel']}"]
    own.append(f"/versions/{mine['rerun']}")
    for path in (*PAGES, *own):
        answer = admin.get(f"/admin{path}", headers={"Accept-Language": language})
        assert answer.status_code == 200, (path, answer.text)
        assert ("Amministrazione" in answer.text) == (language == "it"), path
        assert not re.search(r"<script(?![^>]*\bsrc=)|\s(style|on\w+)=", answer.text), path
        assert "of b" not in answer.text, path


def test_the_overview_says_what_needs_attention(admin, tenants, clock):
    page = admin.get("/admin").text
    for words, number in (("Dead letters", 1), ("Uploads waiting", 1), ("Alerts not delivered", 1)):
        assert re.search(rf'tile-number num">{number}</span></span>\s*<span class="tile-word">{words}', page), words
    clock.advance(days=2)
    with tenants.database.transaction() as session:
        session.get_one(Device, tenants.mine["device"]).last_seen_at = clock() - dt.timedelta(days=2)
    assert re.search(r'num">1</span></span>\s*<span class="tile-word">Boxes silent', admin.get("/admin").text)


@pytest.mark.both_databases
def test_a_box_from_its_making_to_its_end(admin, tenants):
    made = admin.post("/admin/boxes", data={"name": "SC-77", "vehicle_id": tenants.mine["vehicle"], "by": "code"})
    code = secret_in(made.text)
    assert re.fullmatch(r"([0-9A-Z]{4}-){3}[0-9A-Z]{4}", code)
    with tenants.database.reading() as session:
        device = session.scalars(sa.select(Device).where(Device.name == "SC-77")).one()
        assert session.scalars(sa.select(ClaimCode).where(ClaimCode.device_id == device.id)).one().claimed_at is None
    path = f"/admin/boxes/{device.id}"
    claimed = admin.post("/api/v1/claim", json={"code": code}).json()
    assert claimed["id"] == device.id
    token = secret_in(admin.post(f"{path}/token").text)
    assert token.startswith("scd_")
    assert token not in admin.get(path).text
    assert secret_in(admin.post(f"{path}/claim-code").text) != code
    form = {"signed_only": "yes", "megabytes": "12,5", "configuration": '{"rate_hz": 200}'}
    assert admin.post(f"{path}/settings", data=form, follow_redirects=False).status_code == 303
    told = admin.get(f"/api/v1/devices/{device.id}").json()
    assert (told["signed_only"], told["bytes_per_day"], told["configuration"]) == (True, 12_500_000, {"rate_hz": 200})
    assert "12.5" in admin.get(path).text
    for wrong in ({"megabytes": "much"}, {"configuration": "[1]"}, {"configuration": "{"}, {"megabytes": "-1"}):
        answer = admin.post(f"{path}/settings", data=wrong)
        assert answer.status_code == 422, wrong
        assert 'role="alert"' in answer.text
    assert admin.post(f"{path}/vehicle", data={"vehicle_id": "nowhere"}).status_code == 422
    assert admin.post(f"{path}/vehicle", data={}, follow_redirects=False).status_code == 303
    assert admin.get(f"/api/v1/devices/{device.id}").json()["vehicle_id"] is None
    admin.post(f"{path}/revoke")
    assert admin.get(f"/api/v1/devices/{device.id}").json()["revoked_at"] is not None
    assert admin.post(f"{path}/token").status_code == 409
    assert "SC-77" in admin.get("/admin/boxes?show=revoked").text
    assert admin.post("/admin/boxes", data={"name": " "}).status_code == 422
    done = [action for action in actions(tenants.database) if action.startswith("box.")]
    assert done == [
        *("box.added", "box.claim-code", "box.token", "box.claim-code", "box.settings", "box.vehicle", "box.revoked"),
    ]
    with tenants.database.reading() as session:
        log = str([(row.subject, row.detail) for row in session.scalars(sa.select(AuditEntry))])
    assert code not in log
    assert token not in log


@pytest.mark.parametrize(
    ("fields", "parameters"),
    [
        ({"kind": "crash", "min_delta_v": "12,5"}, {"min_delta_v_kmh": 12.5}),
        ({"kind": "silent", "hours": "6"}, {"hours": 6.0}),
        ({"kind": "harsh", "count": "3", "per": "100km"}, {"count": 3.0, "per": "100km"}),
        (
            {"kind": "geofence", "on": "leave", "lat_deg": "45.4", "lon_deg": "11.9", "radius_m": "300"},
            {
                "fence": {"shape": "circle", "lat_deg": 45.4, "lon_deg": 11.9, "radius_m": 300.0},
                "on": "leave",
                "margin_m": 25.0,
            },
        ),
        (
            {"kind": "geofence", "corners": "45.0 7.0\n45.1, 7.0\n\n45.0 7.1\n", "margin_m": "10"},
            {
                "fence": {"shape": "polygon", "corners": [[45.0, 7.0], [45.1, 7.0], [45.0, 7.1]]},
                "on": "both",
                "margin_m": 10.0,
            },
        ),
    ],
)
def test_rules_are_made_shown_changed_and_deleted(admin, tenants, fields, parameters):
    form = {"name": "Night watch", "enabled": "yes", "channels": [tenants.mine["channel"]], "cooldown": "30", **fields}
    made = admin.post("/admin/alerts/rules", data=form, follow_redirects=False)
    assert made.status_code == 303, made.text
    with tenants.database.reading() as session:
        row = session.scalars(sa.select(AlertRule).where(AlertRule.name == "Night watch")).one()
    assert (row.parameters, row.cooldown_s, row.channels) == (parameters, 1800.0, [tenants.mine["channel"]])
    path = f"/admin/alerts/rules/{row.id}"
    # What the form shows is what it would send: saved as it stands, the rule is the same.
    page = admin.get(path).text
    shown = dict(re.findall(r'<input id="\w+" name="(\w+)"[^>]*value="([^"]*)"', page))
    shown |= dict(re.findall(r'<textarea id="\w+" name="(\w+)"[^>]*>([^<]*)<', page))
    chosen = {name: form[name] for name in ("on", "per") if name in form}
    again = {**shown, **chosen, "channels": [tenants.mine["channel"]]}
    assert admin.post(path, data=again, follow_redirects=False).status_code == 303
    with tenants.database.reading() as session:
        changed = session.get_one(AlertRule, row.id)
    assert (changed.parameters, changed.cooldown_s, changed.enabled) == (parameters, 1800.0, False)
    assert admin.post(f"{path}/delete", follow_redirects=False).status_code == 303
    assert admin.get(path).status_code == 404
    done = [action for action in actions(tenants.database) if action.startswith("rule.")]
    assert done == ["rule.added", "rule.changed", "rule.removed"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "nothing"},
        {"name": ""},
        {"hours": "soon"},
        {"hours": "0"},
        {"kind": "geofence", "corners": "45 7 1"},
        {"kind": "geofence", "lat_deg": "95", "lon_deg": "1", "radius_m": "10"},
        {"kind": "geofence"},
        {"channels": "nowhere"},
        {"cooldown": "-1"},
    ],
)
def test_a_wrong_rule_is_refused_in_words(admin, tenants, wrong):
    answer = admin.post("/admin/alerts/rules", data={"kind": "silent", "name": "x", **wrong})
    assert answer.status_code == 422, answer.text
    with tenants.database.reading() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(AlertRule)) == 2


def test_a_channel_shows_its_secret_once_and_is_tried(admin, tenants, monkeypatch):
    sent: list[tuple[str, bytes, dict[str, str]]] = []
    answers = [Answer(delivered=False, status=503, detail="the receiver answered 503"), Answer(True, 200, "")]

    def post(url, body, headers, **_):
        sent.append((url, body, headers))
        return answers.pop()

    monkeypatch.setattr("server.alerts.delivery.webhook.post", post)
    form = {"kind": "webhook", "name": "Control room", "url": "https://example.org/hook", "enabled": "yes"}
    secret = secret_in(admin.post("/admin/alerts/channels", data=form).text)
    assert secret.startswith("scw_")
    with tenants.database.reading() as session:
        row = session.scalars(sa.select(AlertChannel).where(AlertChannel.name == "Control room")).one()
    path = f"/admin/alerts/channels/{row.id}"
    assert secret not in admin.get(path).text
    assert "was taken" in admin.post(f"{path}/test").text
    refused = admin.post(f"{path}/test").text
    assert "was not taken" in refused
    assert "503" in refused
    assert sent[0][0] == "https://example.org/hook"
    assert b'"reason":"test"' in sent[0][1]
    assert sent[0][2]["Scatola-Signature"].startswith("v1=")
    assert secret_in(admin.post(f"{path}/secret").text) != secret
    changed = {"name": "Control", "url": "https://example.org/hook2", "emergency": "yes"}
    assert admin.post(path, data=changed, follow_redirects=False).status_code == 303
    told = admin.get(f"/api/v1/alert-channels/{row.id}").json()
    assert (told["name"], told["emergency"], told["enabled"]) == ("Control", True, False)
    off = admin.post(f"/api/v1/alert-channels/{row.id}/test").json()
    assert off["delivered"] is False
    assert "off" in off["detail"]
    assert admin.post(path, data={"name": "x", "url": "http://127.0.0.1/"}).status_code == 422
    assert admin.post("/admin/alerts/channels", data={"kind": "pigeon"}).status_code == 422
    assert admin.post("/admin/alerts/channels", data={"name": "m", "recipients": "nobody"}).status_code == 422
    mail = {"kind": "email", "name": "Office", "recipients": "a@b.test, c@d.test"}
    assert admin.post("/admin/alerts/channels", data=mail, follow_redirects=False).status_code == 303
    assert admin.post(f"{path}/delete", follow_redirects=False).status_code == 303
    assert admin.get(path).status_code == 404
    done = [action for action in actions(tenants.database) if action.startswith("channel.")]
    assert done == [
        *("channel.added", "channel.tested", "channel.tested", "channel.secret", "channel.changed"),
        *("channel.tested", "channel.added", "channel.removed"),
    ]


@pytest.mark.both_databases
def test_dead_letters_are_replayed_and_re_runs_begun_and_cancelled(admin, tenants):
    assert "of a" in admin.get("/admin/work").text
    admin.post(f"/admin/work/{tenants.mine['device']}/replay")
    with tenants.database.reading() as session:
        assert session.scalars(sa.select(JobFailure.device_id)).all() == [tenants.theirs["device"]]
    begun = admin.post("/admin/versions", data={"device_id": ""}, follow_redirects=False)
    path = begun.headers["location"]
    page = admin.get(path).text
    assert "0 / 1" in page
    assert "running" in page
    admin.post(f"{path}/cancel")
    with tenants.database.reading() as session:
        assert session.get_one(Rerun, path.rsplit("/", 1)[1]).cancelled_at is not None
    assert "cancelled" in admin.get(path).text
    assert admin.post("/admin/versions", data={"device_id": tenants.theirs["device"]}).status_code == 404
    done = actions(tenants.database)
    assert [action for action in done if action in ("jobs.replay", "rerun.begin", "rerun.cancel")] == [
        *("jobs.replay", "rerun.begin", "rerun.cancel"),
    ]


# --- verdicts, revisions, search


@pytest.mark.both_databases
def test_verdicts_come_as_a_file_with_the_detectors_figures(admin, tenants):
    path = f"/api/v1/events/{tenants.mine['event']}"
    assert admin.get("/api/v1/events/verdicts").json() == {"items": []}
    admin.put(f"{path}/review", json={"verdict": "false_alarm", "note": "=cmd|' /C calc'!A0"}).raise_for_status()
    (row,) = admin.get("/api/v1/events/verdicts").json()["items"]
    event = admin.get(path).json()
    assert (row["event_id"], row["verdict"], row["kind"]) == (tenants.mine["event"], "false_alarm", "crash")
    assert row["delta_v_resultant_kmh"] == event["delta_v_kmh"]["resultant"]
    assert [row["pdof_deg_low95"], row["pdof_deg_high95"]] == event["pdof_interval95_deg"]
    assert (row["algorithm"], row["input_sha256"]) == (event["algorithm"], event["input_sha256"])
    assert row["vehicle_class"] == "car"
    assert not {"lat", "lon", "lat_deg"} & row.keys()
    answer = admin.get("/api/v1/events/verdicts?format=csv")
    assert answer.headers["content-disposition"].endswith('.csv"')
    (line,) = csv.DictReader(io.StringIO(answer.text))
    assert line.keys() == row.keys()
    assert line["note"].startswith("'=")
    assert float(line["peak_g"]) == row["peak_g"]
    assert line["quality"].split() == row["quality"]
    day = dt.timedelta(days=1)
    at = dt.datetime.fromisoformat(row["at"])
    for params, count in (({"from": at.isoformat()}, 1), ({"from": (at + day).isoformat()}, 0), ({"to": at}, 0)):
        assert len(admin.get("/api/v1/events/verdicts", params=params).json()["items"]) == count, params
    with tenants.database.reading() as session:
        verdicts = sa.select(AuditEntry).where(AuditEntry.subject == "verdicts").order_by(AuditEntry.id)
        entries = session.scalars(verdicts).all()
    assert [entry.detail["events"] for entry in entries] == [0, 1, 1, 1, 0, 0]


def test_two_revisions_side_by_side(admin, tenants):
    event_id = tenants.mine["event"]
    with tenants.database.transaction() as session:
        event = session.get_one(Event, event_id)
        old = session.scalars(sa.select(EventRevision).where(EventRevision.event_id == event_id)).one()
        kept = {c.key: getattr(old, c.key) for c in sa.inspect(EventRevision).columns if c.key != "id"}
        session.add(EventRevision(**{**kept, "number": 2, "algorithm": "crash-9"}))
        event.revision = 2
    page = admin.get(f"/events/{event_id}/compare?before=1&after=2").text
    assert "The same data, computed by another version." in page
    assert "0 figures changed" in page
    assert "None: both say the same." in page
    assert f"/events/{event_id}/compare?before=1&amp;after=2" in admin.get(f"/events/{event_id}").text
    assert admin.get(f"/events/{event_id}/compare?before=1&after=3").status_code == 404


def test_events_are_found_by_id_and_by_what_was_written(admin, tenants):
    event_id = tenants.mine["event"]
    admin.put(f"/api/v1/events/{event_id}/hold", json={"held": True, "reason": "Claim 47_11"}).raise_for_status()
    for words in (event_id, event_id[:8].upper(), "claim 47_11"):
        found = admin.get("/vehicles", params={"q": words}, follow_redirects=False)
        assert found.headers.get("location") == f"/events/{event_id}", words
    assert admin.get("/vehicles", params={"q": "claim 47x11"}, follow_redirects=False).status_code == 200
    with tenants.database.transaction() as session:
        session.get_one(Vehicle, tenants.mine["vehicle"]).name = "Claim 47_11"
    assert 'id="found-events"' in admin.get("/vehicles", params={"q": "claim 47_11"}).text


def test_speeds_of_an_event_in_the_readers_unit(app, serve, tenants, clock):
    import httpx

    from server.accounts.service import open_session
    from server.models import User

    with tenants.database.transaction() as session:
        session.execute(
            sa.update(User).where(User.id == tenants.mine["user"]).values(preferences={"units": "imperial"})
        )
        opened = open_session(session, tenants.mine["organisation"], now=clock(), user_id=tenants.mine["user"])
    with httpx.Client(base_url=serve(app), cookies={"scatola_session": opened.token}) as browser:
        page = browser.get(f"/events/{tenants.mine['event']}").text
        listed = browser.get("/events").text
        told = browser.get(f"/api/v1/events/{tenants.mine['event']}").json()["delta_v_kmh"]["resultant"]
    words = re.sub(r"<(title|meta|script).*?>", "", page)
    assert f"{told / 1.609344:.1f}" in words
    assert "mph" in page
    assert "km/h" not in words
    assert "km/h" not in listed


def test_a_rule_is_typed_in_the_readers_unit():
    per_kmh = MEASURES["imperial"].per_mps / 3.6
    wanted = _fields({"kind": ["crash"], "name": ["x"], "min_delta_v": ["12,5"]}, per_kmh)
    assert wanted["condition"]["min_delta_v_kmh"] == pytest.approx(12.5 * 1.609344)
    row = AlertRule(
        kind="crash", name="x", enabled=True, channels=[], cooldown_s=60.0, parameters=wanted["condition"]
    )  # fmt: skip
    assert _as_typed(row, per_kmh)["min_delta_v"] == ["12.5"]


# --- trips


@pytest.mark.both_databases
def test_trips_are_listed_filtered_and_paged(admin, tenants, monkeypatch):
    monkeypatch.setattr("server.pages.lists.PAGE", 2)
    with tenants.database.transaction() as session:
        first = session.get_one(Trip, tenants.mine["trip"])
        kept = {c.key: getattr(first, c.key) for c in sa.inspect(Trip).columns if c.key != "id"}
        for k in range(1, 4):
            began = first.began_at + dt.timedelta(days=k)
            session.add(Trip(**{**kept, "began_at": began, "ended_at": began, "distance_m": 1000.0 * k}))

    def listed(**params) -> list[str]:
        answer = admin.get("/trips", params=params)
        assert answer.status_code == 200, answer.text
        assert "vehicle of b" not in answer.text
        return re.findall(r'data-label="Distance, km" class="right num">([\d.]+)<', answer.text)

    assert listed() == ["3.0", "2.0"]
    assert listed(page=2) == ["1.0", "0.0"]
    assert listed(sort="distance", down=False) == ["0.0", "1.0"]
    assert listed(shortest=2.5) == ["3.0"]
    assert listed(since="2026-03-02", until="2026-03-02") == ["1.0"]
    assert listed(q="vehicle of a") == ["3.0", "2.0"]
    assert listed(q="nothing") == []
    for wrong in ({"since": "soon"}, {"sort": "x"}):
        assert admin.get("/trips", params=wrong).status_code == 422, wrong


# --- events


@pytest.mark.both_databases
def test_events_are_listed_filtered_sorted_and_paged(admin, tenants, monkeypatch):
    monkeypatch.setattr("server.pages.lists.PAGE", 2)
    with tenants.database.transaction() as session:
        first = session.get_one(Event, tenants.mine["event"])
        kept = {c.key: getattr(first, c.key) for c in sa.inspect(Event).columns if c.key != "id"}
        for k in range(1, 4):
            at = first.at + dt.timedelta(days=k)
            dv = {**first.result["delta_v_kmh"], "resultant": None if k == 2 else 100.0 - 10.0 * k}
            more = {"at": at, "result": {**first.result, "delta_v_kmh": dv, "peak_g": 50.0 + k}, "note": f"claim {k}"}
            more["verdict"] = "confirmed" if k == 3 else None
            session.add(Event(**{**kept, **more}))
        day = first.at.date() + dt.timedelta(days=2)

    def listed(**params) -> list[str]:
        answer = admin.get("/events", params=params)
        assert answer.status_code == 200, answer.text
        assert "vehicle of b" not in answer.text
        return re.findall(r'data-label="Peak, g" class="right num">([\d.]+)<', answer.text)

    own = f"{first.result['peak_g']:.1f}"
    assert listed() == ["53.0", "52.0"]
    assert listed(page=2) == ["51.0", own]
    assert listed(page=99) == ["51.0", own]
    assert listed(sort="when", down=False) == [own, "51.0"]
    assert listed(sort="delta_v") == ["51.0", "53.0"]
    assert listed(sort="delta_v", page=2) == [own, "52.0"], "what is not known comes last"
    assert listed(sort="delta_v", down=False, page=2)[-1] == "52.0"
    assert listed(sort="peak", down=False) == [own, "51.0"]
    assert listed(review="confirmed") == ["53.0"]
    assert listed(since=str(day), until=str(day)) == ["52.0"]
    assert listed(q="claim 2") == ["52.0"]
    assert listed(q="vehicle of a", review="open") == ["52.0", "51.0"]
    assert listed(q="nothing") == listed(show="manoeuvres") == []
    for wrong in ({"since": "soon"}, {"sort": "x"}, {"page": 0}):
        assert admin.get("/events", params=wrong).status_code == 422, wrong
