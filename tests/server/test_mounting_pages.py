"""The mounting page, the installation assistant, the level and the certificate, over HTTP."""

from __future__ import annotations

import datetime as dt
import re
from html import unescape

import httpx
import numpy as np
import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st
from reportlab.platypus import Paragraph, Table

from nav_core.by_hand import largest_tilt, levelled, orientations
from nav_core.rotation import rotvec_to_matrix, thesis_to_matrix
from server.installations.steps import MAX_STEPS, Step, steps, thinned
from server.models import AuditEntry, Device, Installation, MountingRevision, Organisation, User
from server.reports import certificate as pdf
from server.view3d.axonometry import drawing, projection
from tests.conftest import ADMIN_TOKEN

G = 9.80665
R_VA = thesis_to_matrix(*np.radians([20.0, -35.0, 110.0]))


@pytest.fixture
def browser(address):
    """The administrator's browser, with its CSRF token."""
    with httpx.Client(base_url=address, timeout=30.0) as browser:
        csrf = browser.post("/api/v1/auth/session", json={"code": ADMIN_TOKEN}).json()["csrf_token"]
        browser.headers["X-CSRF-Token"] = csrf
        yield browser


@pytest.fixture
def box(admin):
    """A box in a van, and how it uploads standing still with a specific force."""
    wanted = {"name": "Ducato", "plate": "AB 123 CD", "vehicle_class": "van"}
    vehicle = admin.post("/api/v1/vehicles", json=wanted).json()
    made = admin.post("/api/v1/devices", json={"name": "SC-7", "vehicle_id": vehicle["id"]}).json()
    return Box(admin, made["id"], made["token"], vehicle["id"])


class Box:
    def __init__(self, admin, device_id, token, vehicle_id):
        self.admin, self.id, self.vehicle_id = admin, device_id, vehicle_id
        self._headers = {"Authorization": f"Bearer {token}"}
        self._sequence = 0

    def send(self, f_a, *, scatter=0.02, seconds=2.0, seed=1) -> None:
        t = np.arange(0.0, seconds, 0.02) + 2.0 * self._sequence
        f = np.asarray(f_a) + scatter * np.random.default_rng(seed).normal(size=(t.size, 3))
        columns = {"t": t.tolist(), **{name: f[:, k].tolist() for k, name in enumerate(("fx", "fy", "fz"))}}
        headers = self._headers | {"Idempotency-Key": f"b/{self._sequence}"}
        answer = self.admin.post("/api/v1/batches", json={"columns": columns}, headers=headers)
        assert answer.status_code == 202, answer.text
        self._sequence += 1

    def level(self) -> dict:
        return self.admin.get(f"/api/v1/devices/{self.id}/level").json()


def words(page: httpx.Response) -> str:
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", page.text)))


# --- the level


@given(
    upright=st.tuples(st.integers(0, 2), st.sampled_from([1, -1])),
    tilt=st.floats(0.0, 0.3),
    towards=st.floats(0.0, 6.28),
    choice=st.integers(0, 3),
)
def test_the_measured_tilt_is_taken_out_by_the_smallest_turn(upright, tilt, towards, choice):
    axis, sign = upright
    up = np.zeros(3)
    up[axis] = sign
    f = G * rotvec_to_matrix(tilt * np.roll([0.0, np.cos(towards), np.sin(towards)], axis)) @ up
    plain = orientations(axis, sign)[choice]
    found = levelled(plain, f)
    assert found @ f == pytest.approx([0.0, 0.0, -G], abs=1e-9)
    assert found @ found.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(found) == pytest.approx(1.0)
    angle = np.arccos(np.clip((np.trace(found @ plain.T) - 1.0) / 2.0, -1.0, 1.0))
    assert angle == pytest.approx(tilt, abs=1e-6)


def test_what_the_box_feels_over_http(box, clock):
    nothing = box.level()
    assert nothing["received_at"] is None
    assert (nothing["fresh"], nothing["ok"], nothing["axis"]) == (False, False, None)
    assert nothing["tolerance_deg"] == pytest.approx(18.19, abs=0.01)
    box.send([0.0, G * np.sin(0.1), -G * np.cos(0.1)])
    found = box.level()
    assert (found["axis"], found["sign"], found["ok"], found["still"], found["fresh"]) == ("z", -1, True, True, True)
    assert found["tilt_deg"] == pytest.approx(np.degrees(0.1), abs=0.1)
    assert found["f_v_mps2"] is None, "the mounting is not known"
    box.send([0.0, G * np.sin(0.1), -G * np.cos(0.1)], scatter=1.5)
    assert (box.level()["still"], box.level()["ok"]) == (False, False)
    box.send([0.0, G * np.sin(0.5), -G * np.cos(0.5)])
    assert box.level()["ok"] is False
    clock.advance(minutes=2)
    assert box.level()["fresh"] is False


# --- the assistant


def test_a_box_is_found_by_code_name_and_number_in_its_own_organisation(browser, box, database, clock):
    code = box.admin.post(f"/api/v1/devices/{box.id}/claim-code").json()["code"]
    target = f"/install/{box.id}"
    for typed in (
        code,
        code.lower().replace("-", " "),
        "sc-7",
        box.id,
        box.id[:8],
        f"https://x.test/claim?code={code}",
    ):
        answer = browser.get("/install", params={"code": typed})
        assert (answer.status_code, answer.headers.get("location")) == (303, target), typed
    lost = browser.get("/install", params={"code": "7777-7777-7777-7777"})
    assert lost.status_code == 200
    assert "No box has this code" in lost.text
    with database.transaction() as session:
        other = Organisation(id="b" * 32, name="b", created_at=clock())
        session.add(other)
        session.flush()
        stranger = Device(organisation_id=other.id, name="SC-99", token_hash="b" * 64, created_at=clock())
        session.add(stranger)
        session.flush()
        stranger_id = stranger.id
    for typed in ("SC-99", stranger_id):
        assert browser.get("/install", params={"code": typed}).status_code == 200


def test_only_the_page_that_scans_may_ask_for_the_camera(browser, box):
    assert "camera=(self)" in browser.get("/install").headers["permissions-policy"]
    for path in ("/", f"/install/{box.id}", f"/install/{box.id}/level", f"/devices/{box.id}/mounting"):
        assert "camera=()" in browser.get(path).headers["permissions-policy"], path


def test_a_box_comes_into_a_vehicle_and_the_log_says_who(browser, admin, database):
    made = admin.post("/api/v1/devices", json={"name": "SC-8"}).json()
    vehicle = admin.post("/api/v1/vehicles", json={"name": "Doblo", "plate": "ZZ 1"}).json()
    page = browser.get(f"/install/{made['id']}", params={"q": "zz"})
    assert "Doblo" in page.text
    assert "Drive off" not in page.text, "first the vehicle"
    assert "Doblo" not in browser.get(f"/install/{made['id']}", params={"q": "none"}).text
    answer = browser.post(f"/install/{made['id']}/vehicle", data={"vehicle_id": vehicle["id"]})
    assert answer.status_code == 303
    assert admin.get(f"/api/v1/devices/{made['id']}").json()["vehicle_id"] == vehicle["id"]
    assert "Drive off" in browser.get(f"/install/{made['id']}").text
    with database.reading() as session:
        entry = session.scalars(sa.select(AuditEntry).where(AuditEntry.action == "installed")).one()
    assert entry.subject == f"device_id={made['id']}"


def test_a_level_box_is_confirmed_as_it_stands(browser, box, clock):
    page = f"/install/{box.id}/level"
    assert "Waiting for data" in browser.get(page).text
    tilt = 0.1
    f_a = np.array([0.0, G * np.sin(tilt), -G * np.cos(tilt)])
    box.send(f_a, scatter=0.0)
    shown = browser.get(page)
    assert shown.text.count('name="sits"') == 4
    assert 'value="z-2"' in shown.text
    assert "5.7" in words(shown)
    sent = {"sits": "z-1", "reason": "on the ramp"}
    for change, status in (({"sits": "x+1"}, 409), ({"sits": "z-4"}, 422), ({"reason": ""}, 422)):
        wrong = sent | change
        assert browser.post(page, data=wrong).status_code == status, wrong
    clock.advance(minutes=2)
    late = browser.post(page, data=sent)
    assert late.status_code == 409
    assert "wait for fresh data" in late.text
    box.send(f_a, scatter=0.0)
    done = browser.post(page, data=sent)
    assert (done.status_code, done.headers["location"]) == (303, f"/devices/{box.id}/certificate")
    mounted = box.admin.get(f"/api/v1/devices/{box.id}/installation").json()
    assert (mounted["status"], mounted["method"], mounted["manual_reason"]) == ("ready", "manual", "on the ramp")
    R_va = np.array(mounted["R_va"])
    assert R_va @ f_a == pytest.approx([0.0, 0.0, -G], abs=1e-6)
    assert R_va == pytest.approx(levelled(orientations(2, -1)[1], f_a), abs=1e-9)
    assert mounted["sigma_deg"] == {"x": 2.0, "y": 2.0, "z": 5.0}
    assert tilt < largest_tilt()


def test_driving_off_says_how_far_it_is_and_what_is_missing(browser, box, database, clock):
    page = f"/install/{box.id}/drive"
    assert "Waiting for the first data" in browser.get(page).text
    put_installation(database, box.id, clock(), "settling", (1.0, 1.5, 4.0), 0.6, ["Make two turns."])
    shown = browser.get(page)
    for text in ("Calibrating", "±4.0°", "Make two turns.", "±1.50", 'data-ready="no"', "box is not heard"):
        assert text in unescape(shown.text), text
    assert "60" in words(shown)
    italian = browser.get(page, headers={"Accept-Language": "it"})
    assert "Calibrazione" in italian.text or "calibr" in italian.text.lower()
    assert "±4,0°" in italian.text


# --- the mounting page and the certificate


def put_installation(database, device_id, at, status, sigma, progress=1.0, reasons=(), **columns):
    result = {
        "status": status, "method": "whole-drive", "R_va": R_VA.tolist(),
        "euler_deg": {"theta": 20.0, "phi": -35.0, "psi": 110.0}, "sigma_deg": dict(zip("xyz", sigma, strict=True)),
        "observability": 0.9, "gps_lag_s": {"speed": 0.2, "course": 0.3}, "reasons": list(reasons), "reason_codes": [],
        "percent": round(100 * progress),
    }  # fmt: skip
    common = {"status": status, "progress": progress, "result": result, "algorithm": "w/2", "input_sha256": "c" * 64}
    values = {"beginning": "first", "began_at": at, "updated_at": at} | columns
    with database.transaction() as session:
        device = session.get_one(Device, device_id)
        row = Installation(device_id=device_id, vehicle_id=device.vehicle_id, **common, **values)
        session.add(row)
        session.flush()
        revision = MountingRevision(installation_id=row.id, data_at=at, created_at=at, **common)
        session.add(revision)
        session.flush()
        return row.id, revision.id


def test_the_mounting_page_shows_each_step(browser, box, database, clock):
    page = f"/devices/{box.id}/mounting"
    assert "Not yet" in browser.get(page).text
    assert browser.get(f"/vehicles/{box.vehicle_id}/mounting").headers["location"] == page
    moved_at = clock()
    put_installation(database, box.id, moved_at - dt.timedelta(hours=1), "ready", (0.3, 0.3, 0.5), ended_at=moved_at)
    row, revision = put_installation(
        database, box.id, moved_at, "settling", (1.0, 1.5, 4.0), 0.6, ["Make two turns."], beginning="moved",
        moved_angle_rad=0.6,
    )  # fmt: skip
    box.send(-G * R_VA.T @ [0.0, 0.0, 1.0])
    now = browser.get(page)
    for text in ("Moved, calibrating again", "Make two turns.", "95 % cone", "+9.81", "−9.81", "Heading not known"):
        assert text in unescape(now.text), text
    assert now.text.count("<tr aria-current") == 1
    steps = re.search(r'data-steps="([^"]*)"', now.text)[1].split()
    assert len(steps) == 4
    assert steps[2:] == [revision, row]
    first = browser.get(page, params={"step": steps[0]})
    assert "±0.5" in unescape(first.text)
    assert browser.get(page, params={"step": "gone"}).text.count('data-shown="3"') == 1


def test_the_history_is_in_the_order_of_time(box, database, clock):
    moved_at = clock()
    # What ended was worked out again after the box was moved.
    late = moved_at + dt.timedelta(minutes=30)
    began = moved_at - dt.timedelta(hours=1)
    put_installation(database, box.id, began, "ready", (0.3, 0.3, 0.5), ended_at=moved_at, updated_at=late)
    put_installation(database, box.id, moved_at, "settling", (1.0, 1.5, 4.0), 0.6, beginning="moved")
    with database.reading() as session:
        at = [step.at for step in steps(session, box.id)]
    assert at == [began, moved_at, moved_at, moved_at]


def test_a_long_history_is_thinned_and_keeps_what_matters(clock):
    def step(k, status, installation):
        return Step(str(k), installation, clock(), status, 0.5, {}, None)

    first, second = Installation(id="1"), Installation(id="2")
    found = [step(k, "settling" if k < 900 else "ready", first) for k in range(1000)]
    found += [step(1000 + k, "ready", second) for k in range(500)]
    kept = thinned(found, MAX_STEPS)
    assert len(kept) == MAX_STEPS
    ids = [int(each.id) for each in kept]
    assert ids == sorted(ids)
    assert {0, 900, 999, 1000, 1499} <= set(ids)
    assert thinned(found[:10], MAX_STEPS) == found[:10]


@pytest.fixture
def told(monkeypatch) -> list[str]:
    """What the certificates that are made say: their fonts are cut down, so that the files cannot be read back."""
    said: list[str] = []
    original = pdf._story

    def listened(*arguments):
        story = original(*arguments)
        said.append(" ".join(texts(story)))
        return story

    monkeypatch.setattr(pdf, "_story", listened)
    return said


def texts(part) -> list[str]:
    """Texts of flowables, tables in tables too."""
    if isinstance(part, list | tuple):
        return [text for each in part for text in texts(each)]
    if isinstance(part, Paragraph):
        return [part.text]
    return texts(part._cellvalues) if isinstance(part, Table) else []


def test_a_certificate_states_the_mounting_and_can_be_checked(browser, box, database, clock, told):
    api, page = f"/api/v1/devices/{box.id}/installation/certificate.pdf", f"/devices/{box.id}/certificate"
    for nothing in (None, "settling"):
        if nothing:
            put_installation(
                database, box.id, clock() - dt.timedelta(hours=1), nothing, (1.0, 1.5, 4.0), ended_at=clock()
            )
        refused = browser.get(api)
        assert (refused.status_code, refused.json()["code"]) == (409, "not_ready")
        assert "Not yet" in browser.get(page).text
    browser.post(f"/install/{box.id}/vehicle", data={"vehicle_id": box.vehicle_id})
    _, revision = put_installation(database, box.id, clock(), "ready", (0.3, 0.4, 0.6))
    made = browser.get(api)
    assert made.status_code == 200, made.text
    assert made.headers["content-type"] == "application/pdf"
    assert browser.get(api).content == made.content, "the same bytes each time"
    assert len(re.findall(rb"/Type /Page\b", made.content)) == 1
    for text in ("Ducato", "AB 123 CD", "SC-7", "± 0.60°", "95 % cone", "c" * 64, "w/2", "administrator"):
        assert text in told[0], text
    address = re.search(r'href="([^"]+)"', told[0])[1].replace("&amp;", "&")
    digest = re.search(r"sha256=([0-9a-f]{64})", address)[1]
    assert f"/devices/{box.id}/certificate?mounting={revision}&" in address
    query = {"mounting": revision, "sha256": digest}
    assert "The hash agrees" in browser.get(page, params=query).text
    assert "does not agree" in browser.get(page, params=query | {"sha256": "0" * 64}).text
    browser.get(api, params={"lang": "it"}).raise_for_status()
    assert "Certificato d'installazione" in unescape(told[-1])
    assert "± 0,60°" in told[-1]
    # A newer estimate makes another certificate; the old one can still be made, to the byte, and a move says so.
    clock.advance(hours=1)
    with database.transaction() as session:
        row = session.scalars(sa.select(Installation).where(Installation.ended_at.is_(None))).one()
        row.ended_at = clock()
    put_installation(database, box.id, clock(), "ready", (0.1, 0.1, 0.2), beginning="moved")
    assert browser.get(api, params={"mounting": revision}).content == made.content
    past = browser.get(page, params=query)
    assert "The hash agrees" in past.text
    assert "of the past" in past.text
    assert browser.get(api, params={"mounting": "gone"}).status_code == 404


# --- pictures without WebGL


@pytest.mark.parametrize("vehicle_class", ["car", "van", "truck", "bus", "motorcycle", "unknown"])
def test_the_axonometry_shows_three_faces_and_stays_in_its_frame(vehicle_class):
    found = drawing(vehicle_class, R_VA)
    assert sum(stroke.kind.startswith("face") for stroke in found.strokes) == 3
    xs, ys = zip(*(point for stroke in found.strokes for point in stroke.points), strict=True)
    assert found.left <= min(xs)
    assert max(xs) <= found.left + found.width
    assert found.top <= min(ys)
    assert max(ys) <= found.top + found.height


def test_the_eye_is_ahead_on_the_right_and_above():
    right, down, towards = projection()
    assert right[0] > 0, "ahead is at the right"
    assert right[1] < 0, "the vehicle's right is at the left"
    assert down[2] > 0
    assert towards[2] < 0


def test_an_installer_installs_and_does_no_more(admin, box, database, clock):
    from server.accounts.service import open_session

    with database.transaction() as session:
        organisation = session.scalars(sa.select(Organisation)).first()
        user = User(organisation_id=organisation.id, email="i@x.test", name="Ida", role="installer", created_at=clock())
        session.add(user)
        session.flush()
        opened = open_session(session, organisation.id, now=clock(), user_id=user.id)
        other = User(organisation_id=organisation.id, email="r@x.test", name="R", role="reader", created_at=clock())
        session.add(other)
        session.flush()
        reading = open_session(session, organisation.id, now=clock(), user_id=other.id)
    base = str(admin.base_url)
    with httpx.Client(base_url=base, cookies={"scatola_session": opened.token}) as ida:
        for path in ("/install", f"/install/{box.id}", f"/install/{box.id}/drive", f"/install/{box.id}/level"):
            assert ida.get(path).status_code == 200, path
        headers = {"X-CSRF-Token": opened.csrf_token}
        sent = ida.post(f"/install/{box.id}/vehicle", data={"vehicle_id": box.vehicle_id}, headers=headers)
        assert sent.status_code == 303
        assert ida.post(f"/install/{box.id}/vehicle", data={"vehicle_id": box.vehicle_id}).status_code == 403
        put_installation(database, box.id, clock(), "ready", (0.3, 0.4, 0.6))
        assert "i@x.test" in ida.get(f"/devices/{box.id}/certificate").text
    with httpx.Client(base_url=base, cookies={"scatola_session": reading.token}) as reader:
        for path in ("/install", f"/install/{box.id}", f"/install/{box.id}/level"):
            assert reader.get(path).status_code == 403, path
        assert reader.get(f"/devices/{box.id}/certificate").status_code == 200
        assert "/install" not in reader.get(f"/devices/{box.id}/mounting").text
