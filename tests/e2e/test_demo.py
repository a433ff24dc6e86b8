"""`scatola demo` as a new user meets it: an estimate soon, a clean end, and the next start goes on."""

from __future__ import annotations

import signal
import time

import httpx
import pytest

from tests.e2e.service import Service, alive, eventually

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def installations(client: httpx.Client) -> dict[str, dict]:
    devices = client.get("/api/v1/devices").raise_for_status().json()["items"]
    return {
        device["name"]: client.get(f"/api/v1/devices/{device['id']}/installation").raise_for_status().json()
        for device in devices
    }


def test_the_demo_calibrates_stops_cleanly_and_goes_on(tmp_path):
    with (
        Service(tmp_path / "data", "demo", "--speed", "120", "--history-minutes", "20") as service,
        service.client() as client,
    ):
        walk(service, client)


def walk(service: Service, client: httpx.Client):
    assert httpx.get(service.sign_in, trust_env=False).status_code == 200

    def ready() -> set[str]:
        return {name for name, state in installations(client).items() if state["status"] == "ready"}

    eventually(lambda: {"SC-0001", "SC-0002"} <= ready(), within_s=120, what="two boxes are ready")
    assert len(installations(client)) == 9
    assert installations(client)["SC-0005"]["status"] == "insufficient"
    crash = {"kind": "crash", "severe": True}
    (event,) = eventually(
        lambda: client.get("/api/v1/events", params=crash).raise_for_status().json()["items"],
        within_s=120,
        what="the demo's crash is found",
    )
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0, rel=0.15)
    assert "Jeep Renegade" in client.get("/events").text
    assert client.get(f"/api/v1/events/{event['id']}/scene.viser").status_code == 200
    before = {name: state["R_va"] for name, state in installations(client).items()}
    children = service.children()
    assert set(children) == {"worker", "viewer", "demo-fleet"}

    began = time.monotonic()
    assert service.stop(signal.SIGINT) == 0
    assert time.monotonic() - began < 10.0
    assert not any(alive(pid) for pid in children.values())

    service.start()
    assert set(installations(client)) == set(before)
    assert all(state["R_va"] is not None for name, state in installations(client).items() if before[name] is not None)
    assert service.stop() == 0
