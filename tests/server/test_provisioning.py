"""How a box gets its token and keeps it: claim codes, rotation, signatures, configuration, requests, quotas."""

from __future__ import annotations

import datetime as dt
import json

import httpx
import numpy as np
import pytest
import sqlalchemy as sa

from server.accounts.secrets import hash_of
from server.accounts.signature import sign
from server.formats.columns import Columns
from server.models import Batch, ClaimCode
from server.uploader import NotAdmittedError, Parcel, Uploader, encode

pytestmark = pytest.mark.both_databases
BODY = json.dumps({"columns": {"t": [0.0], "temp": [20.0]}}).encode()


def send(client, token, sequence=0, *, body=BODY, **headers) -> httpx.Response:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return client.post(
        "/api/v1/batches",
        content=body,
        headers={
            "Authorization": f"Bearer {token}",
            "Idempotency-Key": f"b/{sequence}",
            "Content-Type": "application/json",
            **named,
        },
    )


def bearer(token) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


# --- claim codes


def test_a_code_is_traded_until_its_token_is_used(client, admin, make_device, database):
    device_id, first = make_device()
    made = admin.post(f"/api/v1/devices/{device_id}/claim-code")
    assert made.status_code == 201
    code = made.json()["code"]
    with database.reading() as session:
        assert code.replace("-", "") not in str(session.execute(sa.select(ClaimCode.code_hash)).all())
    # Typed with small letters and look-alikes; the first answer is lost on its way.
    typed = code.lower().replace("0", "o").replace("1", "l")
    lost = client.post("/api/v1/claim", json={"code": typed})
    assert lost.status_code == 200, lost.text
    assert (lost.json()["id"], lost.json()["server_time"]) == (device_id, "2026-03-01T12:00:00Z")
    again = client.post("/api/v1/claim", json={"code": code})
    token = again.json()["token"]
    assert [send(client, old).status_code for old in (first, lost.json()["token"])] == [401, 401]
    assert send(client, token).status_code == 202
    used = client.post("/api/v1/claim", json={"code": code})
    assert (used.status_code, used.json()["code"]) == (401, "claim_failed")
    assert send(client, token).status_code == 202


def test_codes_end(client, admin, make_device, clock):
    device_id, token = make_device()
    codes = [admin.post(f"/api/v1/devices/{device_id}/claim-code").json()["code"] for _ in range(2)]
    assert client.post("/api/v1/claim", json={"code": codes[0]}).status_code == 401
    clock.advance(days=91)
    assert client.post("/api/v1/claim", json={"code": codes[1]}).status_code == 401
    fresh = admin.post(f"/api/v1/devices/{device_id}/claim-code").json()["code"]
    admin.post(f"/api/v1/devices/{device_id}/revoke")
    assert client.post("/api/v1/claim", json={"code": fresh}).status_code == 401
    assert admin.post(f"/api/v1/devices/{device_id}/claim-code").status_code == 409
    assert send(client, token).status_code == 401


def test_guessing_codes_is_slowed_down(client, clock):
    answers = [client.post("/api/v1/claim", json={"code": "0" * 16}) for _ in range(61)]
    assert [answer.status_code for answer in answers] == [401] * 60 + [429]
    assert int(answers[-1].headers["retry-after"]) >= 1
    clock.advance(minutes=1)
    assert client.post("/api/v1/claim", json={"code": "0" * 16}).status_code == 401
    assert client.post("/api/v1/claim", json={"code": "x"}).status_code == 422


# --- rotation by the box


def test_the_old_token_lasts_until_the_new_one_is_used(client, make_device):
    _, old = make_device()
    lost = client.post("/api/v1/device/token", headers=bearer(old)).json()["token"]
    new = client.post("/api/v1/device/token", headers=bearer(old)).json()["token"]
    assert send(client, lost).status_code == 401
    assert send(client, old).status_code == 202
    assert send(client, new, 1).status_code == 202
    assert send(client, old, 2).status_code == 401
    assert send(client, new, 2).status_code == 202


def test_an_administrators_rotation_ends_both(client, admin, make_device):
    device_id, old = make_device()
    pending = client.post("/api/v1/device/token", headers=bearer(old)).json()["token"]
    new = admin.post(f"/api/v1/devices/{device_id}/token").json()["token"]
    assert [send(client, token).status_code for token in (old, pending, new)] == [401, 401, 202]


# --- signatures


def signed(client, device_id, token, time_s, *, sequence=0, body=BODY, sent=None, **changes) -> httpx.Response:
    headers = {"idempotency-key": f"b/{sequence}", "content-type": "application/json"}
    value = sign(
        hash_of(token),
        method="POST",
        path="/api/v1/batches",
        device_id=device_id,
        time_s=int(time_s),
        headers=headers,
        body=body,
    )
    return client.post(
        "/api/v1/batches", content=body if sent is None else sent, headers=headers | {"authorization": value} | changes
    )


def test_a_signed_request_shows_no_token(client, admin, make_device, clock):
    device_id, token = make_device()
    now = clock().timestamp()
    first = signed(client, device_id, token, now)
    assert first.status_code == 202, first.text
    assert token not in str(first.request.headers)
    assert signed(client, device_id, token, now - 299).json()["duplicate"]
    for wrong in (
        signed(client, device_id, token + "x", now, sequence=1),
        signed(client, "0" * 32, token, now, sequence=1),
        signed(client, device_id, token, now, sequence=1, sent=BODY + b" "),
        signed(client, device_id, token, now, sequence=1, **{"idempotency-key": "b/2"}),
        signed(client, device_id, token, now, sequence=1, **{"scatola-stream": "burst"}),
        signed(client, device_id, token, now, sequence=1, **{"scatola-sent-at": "86400"}),
        signed(client, device_id, token, now, sequence=1, **{"scatola-configuration": "1"}),
        signed(client, device_id, token, now, sequence=1, **{"scatola-answers": "0" * 32}),
        signed(client, device_id, token, now, sequence=1, authorization="Scatola-HMAC-SHA256 x"),
    ):
        assert (wrong.status_code, wrong.json()["code"]) == (401, "signature"), wrong.text
    replayed = signed(client, device_id, token, now - 301)
    assert (replayed.status_code, replayed.json()["code"]) == (401, "clock_skew")
    assert replayed.json()["server_time"] == "2026-03-01T12:00:00+00:00"
    admin.put(f"/api/v1/devices/{device_id}/settings", json={"signed_only": True})
    bare = send(client, token, 3)
    assert (bare.status_code, bare.json()["code"]) == (401, "signature_required")
    assert signed(client, device_id, token, now, sequence=3).status_code == 202
    admin.post(f"/api/v1/devices/{device_id}/revoke")
    assert signed(client, device_id, token, now, sequence=4).status_code == 401


def test_the_first_signature_by_a_new_token_ends_the_old_one(client, make_device, clock):
    device_id, token = make_device()
    now = int(clock().timestamp())
    new = client.post("/api/v1/device/token", headers=bearer(token)).json()["token"]
    assert signed(client, device_id, token, now).status_code == 202
    assert signed(client, device_id, new, now, sequence=1).status_code == 202
    assert signed(client, device_id, token, now, sequence=2).status_code == 401
    assert client.get("/api/v1/device", headers=bearer(token)).status_code == 401
    assert client.get("/api/v1/device", headers=bearer(new)).status_code == 200


def test_a_signature_gives_no_token_away(client, make_device, clock):
    device_id, token = make_device()
    path = "/api/v1/device/token"
    value = sign(
        hash_of(token),
        method="POST",
        path=path,
        device_id=device_id,
        time_s=int(clock().timestamp()),
        headers={},
        body=b"",
    )
    assert client.post(path, headers={"authorization": value}).status_code == 403


def test_the_client_takes_over_the_services_time(client, make_device, clock):
    device_id, token = make_device()
    part = Columns({"t": np.array([0.0]), "temp": np.array([1.0])})
    parcel = Parcel("continuous", "b", 0, *encode(part, "compact"))
    # A box whose clock still stands in 1970.
    uploader = Uploader(client, token, "b", wait=lambda _: None, sign_as=device_id, clock=lambda: 100.0)
    assert uploader.deliver(parcel).next_sequence == 1
    assert uploader.send(1, part).next_sequence == 2
    stranger = Uploader(client, "x", "b", wait=lambda _: None, sign_as=device_id, clock=lambda: 100.0)
    with pytest.raises(NotAdmittedError):
        stranger.deliver(parcel)
    assert clock.now.year == 2026


# --- what a box is told


def test_what_a_box_is_asked_stands_in_the_audit_log(admin, make_device):
    device_id, _ = make_device()
    path = f"/api/v1/devices/{device_id}/requests"
    asked = admin.post(path, json={"boot": "a", "t_first_s": 10.0, "t_last_s": 20.0}).json()
    assert admin.delete(f"{path}/{asked['id']}").status_code == 204
    log = admin.get("/api/v1/audit").json()["items"]
    assert [entry["action"] for entry in log][:2] == ["box.not-asked", "box.asked"]
    assert log[0]["subject"] == f"device={device_id} request={asked['id']}"


def test_a_configuration_is_told_until_the_box_has_it(client, admin, make_device):
    device_id, token = make_device()
    assert send(client, token).json()["requests"] == []
    path = f"/api/v1/devices/{device_id}/settings"
    assert admin.put(path, json={"configuration": {"accel_hz": 200}}).json()["configuration_version"] == 1
    told = [{"kind": "configuration", "version": 1, "values": {"accel_hz": 200}}]
    assert send(client, token, 1).json()["requests"] == told
    assert client.get("/api/v1/device", headers=bearer(token)).json()["requests"] == told
    assert send(client, token, 2, Scatola_Configuration="1").json()["requests"] == []
    assert admin.get(f"/api/v1/devices/{device_id}").json()["configuration_seen"] == 1
    admin.put(path, json={"configuration": {"accel_hz": 200}})
    assert send(client, token, 3, Scatola_Configuration="1").json()["requests"] == []
    admin.put(path, json={"configuration": None})
    assert send(client, token, 4, Scatola_Configuration="1").json()["requests"] == [
        {"kind": "configuration", "version": 2, "values": {}}
    ]
    assert admin.put(path, json={"configuration": {"x": "y" * 5000}}).status_code == 422


def test_a_window_is_asked_for_until_a_batch_answers(client, admin, make_device, clock):
    device_id, token = make_device()
    path = f"/api/v1/devices/{device_id}/requests"
    wanted = {"boot": "b", "t_first_s": 10.0, "t_last_s": 20.0, "reason": "impact"}
    ids = [admin.post(path, json=wanted).json()["id"] for _ in range(3)]
    told = send(client, token).json()["requests"]
    assert [request["id"] for request in told] == ids
    assert told[0] == {"kind": "window", "id": ids[0], "boot": "b", "t_first_s": 10.0, "t_last_s": 20.0}
    assert admin.delete(f"{path}/{ids[1]}").status_code == 204
    answer = send(client, token, 0, Scatola_Stream="burst", Scatola_Answers=f"{ids[0]}, {'0' * 32}")
    assert [request["id"] for request in answer.json()["requests"]] == [ids[2]]
    listed = {request["id"]: request for request in admin.get(path).json()}
    assert (listed[ids[0]]["outcome"], listed[ids[0]]["batch_id"]) == ("answered", answer.json()["batch_id"])
    assert listed[ids[1]]["outcome"] == "cancelled"
    clock.advance(days=8)
    assert send(client, token, 1).json()["requests"] == []
    assert admin.post(path, json=wanted | {"t_last_s": 1.0}).status_code == 422
    assert [admin.post(path, json=wanted).status_code for _ in range(21)] == [201] * 20 + [409]


@pytest.mark.parametrize(
    "headers",
    [
        {"Scatola_Sent_At": "soon"},
        {"Scatola_Sent_At": "nan"},
        {"Scatola_Sent_At": "1e11"},
        {"Scatola_Configuration": "-1"},
        {"Scatola_Configuration": "x"},
        {"Scatola_Answers": "../x"},
    ],
)
def test_notes_that_mean_nothing_are_refused(client, make_device, headers):
    _, token = make_device()
    answer = send(client, token, **headers)
    assert (answer.status_code, answer.json()["code"]) == (422, "box_notes")


def test_the_clock_of_sending_is_kept(client, make_device, database):
    _, token = make_device()
    assert send(client, token, Scatola_Sent_At="12.5").status_code == 202
    with database.reading() as session:
        assert session.scalars(sa.select(Batch.sent_t_s)).one() == 12.5


# --- quotas


def test_a_quota_ends_at_midnight_and_leaves_room_for_bursts(client, admin, make_device, clock):
    device_id, token = make_device()
    size = len(BODY)
    admin.put(f"/api/v1/devices/{device_id}/settings", json={"bytes_per_day": 2 * size})
    assert [send(client, token, n).status_code for n in range(3)] == [202, 202, 429]
    refused = send(client, token, 2)
    assert refused.json()["code"] == "quota"
    assert int(refused.headers["retry-after"]) == 12 * 3600 + 1
    # What is known already costs nothing, and a burst may go twice as far.
    assert send(client, token, 0).json()["duplicate"]
    assert [send(client, token, n, Scatola_Stream="burst").status_code for n in range(3)] == [202, 202, 429]
    clock.now = dt.datetime(2026, 3, 2, 0, 0, 1, tzinfo=dt.UTC)
    assert send(client, token, 2).status_code == 202
