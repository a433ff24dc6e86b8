"""Recorded replays: what they hold, and who gets them."""

from __future__ import annotations

import logging
import socket
import threading

import httpx
import numpy as np
import pytest
import rich
import uvicorn
import zstandard
from crash_world import Reconstructor, crash
from fleet_world import Leg, World, cut, drive_of

from server.events.canonical import settle
from server.events.document import document_of
from server.view3d.instants import instants
from server.view3d.recording import Way, record
from server.view3d.viewer import create_viewer

INPUTS = {"vehicle_class": "van", "batches": [], "clock": {"source": "gnss"}}


@pytest.fixture
def document():
    return settle(document_of(crash(100.0), INPUTS, device_id="d", boot="b"))


@pytest.fixture(autouse=True)
def quiet():
    rich.reconfigure(quiet=True)
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    yield
    rich.reconfigure(quiet=False)


def test_the_vehicle_goes_where_the_path_went(document):
    way = Way(document)
    at = int(np.argmin(np.abs(way.t)))
    assert way.t[at] == 0.0
    position, turn = way.at(at)
    assert np.abs(position).max() < 0.7
    # Heading 0.6 rad, clockwise from north; north is the world's x, east its -y.
    ahead = turn @ [1.0, 0.0, 0.0]
    assert np.arctan2(-ahead[1], ahead[0]) == pytest.approx(0.6, abs=0.01)
    assert turn @ [0.0, 0.0, 1.0] == pytest.approx([0.0, 0.0, -1.0])


def test_the_replay_begins_where_the_page_is_told(document):
    """On the first twentieth of a second with a known place, six seconds before at the earliest."""
    assert (instants(document)[0], instants(document)[-1]) == (-6.0, 6.0)
    way = document["curves"]["trajectory"]
    for k, t in enumerate(way["t_s"]):
        if not -3.33 <= t <= 4.01:
            way["north_m"][k] = None
    first, last = (f(t for t in way["t_s"] if -3.33 <= t <= 4.01) for f in (min, max))
    shown = instants(document)
    assert 0.0 <= shown[0] - first < 0.05
    assert 0.0 <= last - shown[-1] < 0.05
    # The blow in steps of 5 ms, the rest in steps of 50.
    blow = (shown >= -0.05) & (shown <= 0.25)
    np.testing.assert_allclose(np.diff(shown[blow]), 0.005)
    assert blow.sum() == 61
    np.testing.assert_allclose(np.diff(shown[shown <= -0.05]), 0.05)
    np.testing.assert_allclose(np.diff(shown[shown >= 0.25]), 0.05)
    np.testing.assert_array_equal(Way(document).t, shown)
    for gone in (None, {**way, "north_m": [None] * len(way["t_s"])}):
        document["curves"]["trajectory"] = gone
        assert (instants(document)[0], instants(document)[-1]) == (-1.0, 1.0)


def test_a_recording_holds_frames_and_the_force(document):
    # viser's form: the length of what follows, then zstd.
    raw = zstandard.ZstdDecompressor().decompress(record(document)[8:], max_output_size=64_000_000)
    assert b"/vehicle/force/arrow" in raw
    assert b"delta-V 32 km/h" in raw
    assert raw.count(b"SetPositionMessage") > 200


def test_without_path_or_direction_there_is_still_a_vehicle(document):
    document["curves"]["trajectory"] = None
    document["event"] |= {"pdof_deg": None, "pdof_interval95_deg": None}
    assert len(record(document)) > 1000


def test_a_replay_over_http(admin, client, app, database, settings, clock, organisation):
    world = World(database, settings, clock, organisation)
    world.reconstructor = Reconstructor(crash(100.0))
    for k, batch in enumerate(cut(drive_of(Leg(100, 12.0), Leg(60, 0.0)), seconds=80.0)):
        world.put(batch, k)
    world.bring_up()
    (event,) = admin.get("/api/v1/events").json()["items"]
    path = f"/api/v1/events/{event['id']}/scene.viser"
    assert admin.get(path).status_code == 503
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = uvicorn.Config(
        create_viewer(settings, clock=clock), host="127.0.0.1", port=port, log_config=None, timeout_graceful_shutdown=2
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    app.state.viewer_url = f"http://127.0.0.1:{port}"
    try:
        answer = next(a for _ in range(200) if (a := admin.get(path)).status_code != 503)
        assert answer.status_code == 200
        assert "attachment" in answer.headers["content-disposition"]
        assert answer.content == admin.get(path).content
        assert client.get(path).status_code == 401
        assert admin.get("/api/v1/events/" + "0" * 32 + "/scene.viser").status_code == 404
        ticket = admin.post(f"/api/v1/events/{event['id']}/view-ticket").json()["url"]
        inside = f"{ticket}events/{event['id']}.viser"
        assert httpx.get(f"{client.base_url}{inside}").status_code == 200
        other = world.new_device()
        ticket = admin.post(f"/api/v1/devices/{other}/view-ticket").json()["url"]
        assert httpx.get(f"{client.base_url}{ticket}events/{event['id']}.viser").status_code == 403
        # The replay follows the vehicle's way: a ticket for the box alone does not open it.
        ticket = admin.post(f"/api/v1/devices/{world.device_id}/view-ticket").json()["url"]
        assert httpx.get(f"{client.base_url}{ticket}").status_code == 200
        assert httpx.get(f"{client.base_url}{ticket}events/{event['id']}.viser").status_code == 403
    finally:
        server.should_exit = True
        thread.join(10.0)
