from __future__ import annotations

import asyncio
import datetime as dt
import gc
import socket
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import httpx
import msgspec
import numpy as np
import pytest
import rich
import uvicorn
import viser
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from nav_core.rotation import error_between
from server.accounts.service import ensure_organisation
from server.database import Database
from server.errors import NotFoundError, UnavailableError
from server.formats.columns import Columns
from server.live.changes import announce
from server.models import Batch, Device, DeviceState, Installation, Vehicle, ViewTicket, new_id
from server.store import open_store
from server.view3d import bodywork, permission
from server.view3d.live import dashes, north_east_down
from server.view3d.pool import ScenePool, close_share
from server.view3d.relay import same_origin
from server.view3d.scene import R_WORLD_V, MountingScene, headline, panel_html
from server.view3d.uncertainty import SIGMAS_95, axis_ellipse, cone
from server.view3d.view import MountingView, load, view_of
from server.view3d.viewer import client_page, create_viewer
from tests.e2e.service import eventually

NOW = dt.datetime(2026, 3, 12, 14, 3, tzinfo=dt.UTC)
R_VA = Rotation.from_euler("YZX", [20.0, -35.0, 110.0], degrees=True).as_matrix()
READY = {"status": "ready", "R_va": R_VA.tolist(), "sigma_deg": {"x": 0.6, "y": 0.5, "z": 0.9}, "reasons": ["Done."]}
SUBPROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module", autouse=True)
def quiet_console() -> Generator[None]:
    rich.reconfigure(quiet=True)
    yield
    rich.reconfigure(quiet=False)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


# --- what is drawn -----------------------------------------------------------------------------------------------


@pytest.fixture
def viser_server() -> Generator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


def ready_view(**changes: object) -> MountingView:
    result = {**READY, **changes}
    return view_of("AB 123 CD", "car", str(result["status"]), result, progress=1.0, at=NOW)


def matrix_of(server: viser.ViserServer, name: str) -> np.ndarray:
    node = server.scene.get_handle_by_name(name)
    assert node is not None
    return Rotation.from_quat(node.wxyz, scalar_first=True).as_matrix()


def world_matrix(server: viser.ViserServer, name: str) -> np.ndarray:
    parts = name.strip("/").split("/")
    rotation = np.eye(3)
    for depth in range(1, len(parts) + 1):
        rotation = rotation @ matrix_of(server, "/" + "/".join(parts[:depth]))
    return rotation


def test_the_v_frame_stands_in_the_world_with_z_down(viser_server):
    MountingScene(viser_server).show(ready_view())
    world_v = matrix_of(viser_server, "/vehicle")
    forward, right, down = world_v.T
    assert forward == pytest.approx([1, 0, 0])
    assert down == pytest.approx([0, 0, -1])
    assert np.cross(down, forward) == pytest.approx(right)
    assert world_v == pytest.approx(R_WORLD_V)


def test_the_box_is_drawn_as_R_va_says(viser_server):
    MountingScene(viser_server).show(ready_view())
    drawn = world_matrix(viser_server, "/vehicle/mounting/box")
    assert drawn == pytest.approx(R_WORLD_V @ R_VA, abs=1e-9)
    for axis, name in enumerate("xyz"):
        arrow = viser_server.scene.get_handle_by_name(f"/vehicle/mounting/box/{name}")
        tip = np.asarray(arrow.points)[0, 1]
        assert drawn @ tip / np.linalg.norm(tip) == pytest.approx((R_WORLD_V @ R_VA)[:, axis], abs=1e-6)


def test_axes_keep_their_colours_in_both_frames(viser_server):
    MountingScene(viser_server).show(ready_view())
    for axis, name in enumerate("xyz"):
        for node in (f"/vehicle/body/v/{name}", f"/vehicle/mounting/box/{name}"):
            colours = np.asarray(viser_server.scene.get_handle_by_name(node).colors).reshape(-1, 3)
            assert int(np.argmax(colours[0])) == axis


def test_a_moved_box_turns_and_unknown_orientation_is_never_drawn(viser_server):
    scene = MountingScene(viser_server)
    scene.show(ready_view())
    turned = Rotation.from_rotvec([0.0, 0.0, 0.6]).as_matrix() @ R_VA
    scene.show(ready_view(R_va=turned.tolist()))
    assert matrix_of(viser_server, "/vehicle/mounting/box") == pytest.approx(turned)
    for status in ("insufficient", "not_fixed"):
        # Even a result that carries a stale matrix is drawn as a ghost.
        scene.show(ready_view(status=status))
        assert viser_server.scene.get_handle_by_name("/vehicle/mounting/box") is None
        assert viser_server.scene.get_handle_by_name("/vehicle/mounting/ghost") is not None
    scene.show(ready_view())
    assert viser_server.scene.get_handle_by_name("/vehicle/mounting/ghost") is None


def test_the_reference_is_drawn_beside_the_estimate(viser_server):
    truth = Rotation.from_rotvec([0.02, 0.0, 0.05]).as_matrix() @ R_VA
    references = [
        {"from": "2026-03-01T00:00:00+00:00", "R_va": np.eye(3).tolist()},
        {"from": "2026-03-12T14:00:00+00:00", "R_va": truth.tolist()},
        {"from": "2026-03-12T15:00:00+00:00", "R_va": np.eye(3).tolist()},
    ]
    view = view_of("AB 123 CD", "van", "ready", READY, progress=1.0, references=references, at=NOW)
    MountingScene(viser_server).show(view)
    drawn = matrix_of(viser_server, "/vehicle/mounting/reference")
    assert error_between(drawn, R_VA) == pytest.approx([0.02, 0.0, 0.05], abs=1e-9)
    assert view_of("x", "car", "ready", READY, references=references[2:], at=NOW).reference is None


def test_words_of_the_panel_are_escaped_and_complete():
    hostile = view_of(
        "<script>x</script>", "car", "settling", {**READY, "reasons": ["Make <two> turns."]}, progress=0.6, at=NOW
    )
    panel = panel_html(hostile)
    assert "<script>" not in panel
    assert "&lt;script&gt;" in panel
    assert "Make &lt;two&gt; turns." in panel
    assert "x ±0.6°" in panel
    assert "not known yet" in panel_html(view_of("box", "car", None, {}, at=NOW))
    assert headline(hostile) == "Calibrating · 60 %"
    assert headline(ready_view()) == "Ready · ±0.9°"


@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    sigma=st.tuples(*[st.floats(1e-3, 0.2)] * 3),
    axis=st.integers(0, 2),
)
def test_the_cone_holds_95_percent_of_where_the_axis_may_be(turn, sigma, axis):
    direction = Rotation.from_rotvec(turn).as_matrix()[:, axis]
    half_angles, across = axis_ellipse(direction, np.array(sigma))
    assert across @ direction == pytest.approx(0.0, abs=1e-7)
    assert across @ across.T == pytest.approx(np.eye(2), abs=1e-9)
    covariance = across.T @ np.diag((half_angles / SIGMAS_95) ** 2) @ across
    skewed = np.cross(np.eye(3), direction)
    assert covariance == pytest.approx(skewed.T @ np.diag(np.square(sigma)) @ skewed, abs=1e-9)


def test_coverage_of_the_cone_and_its_mesh():
    sigma = np.radians([0.5, 1.0, 4.0])
    direction = R_VA[:, 0]
    half_angles, across = axis_ellipse(direction, sigma)
    errors = np.random.default_rng(7).normal(size=(20_000, 3)) * sigma
    moved = direction + np.cross(errors, direction)
    inside = np.square((moved @ across.T) / half_angles).sum(axis=1) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.006)
    vertices, faces = cone(direction, sigma, 2.0)
    angles = np.arccos(vertices[1:] @ direction / 2.0)
    assert angles.min() == pytest.approx(half_angles[0], rel=0.01)
    assert angles.max() == pytest.approx(half_angles[1], rel=0.01)
    assert faces.max() == len(vertices) - 1


@pytest.mark.parametrize("name", bodywork.BODIES)
def test_bodies_are_closed_symmetric_and_stand_on_the_ground(name):
    body = bodywork.BODIES[name]
    for loft in body.lofts:
        vertices, faces = bodywork.shell(loft)
        edges = {(a, b) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
        assert all((b, a) in edges for a, b in edges), "every edge has a triangle on both sides"
        assert vertices[:, 1].min() == pytest.approx(-vertices[:, 1].max())
        assert (vertices[:, 2] < 0).all()
        assert np.abs(vertices[:, 0]).max() <= body.length / 2 + 0.01
        corners = vertices[faces]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        assert volume > 0, "normals point outwards"
    assert all(wheel.radius > 0 for wheel in body.wheels)
    assert -body.height < body.box[2] < 0


# --- rows, tickets, pool -----------------------------------------------------------------------------------------


def add_device(database: Database, *, result: dict | None = None) -> Device:
    with database.transaction() as session:
        organisation = ensure_organisation(session, now=NOW)
        vehicle = Vehicle(organisation_id=organisation.id, name="AB 123 CD", vehicle_class="van", created_at=NOW)
        session.add(vehicle)
        session.flush()
        device = Device(
            organisation_id=organisation.id, name="box", token_hash=new_id() * 2,
            created_at=NOW, vehicle_id=vehicle.id,
        )  # fmt: skip
        session.add(device)
        session.flush()
        if result is not None:
            put_result(session, device, result)
        return device


def put_result(session, device: Device, result: dict, **columns: object) -> None:
    values = {"progress": 1.0, "beginning": "first", "began_at": NOW} | columns
    session.add(
        Installation(
            device_id=device.id, vehicle_id=device.vehicle_id, updated_at=NOW, status=result["status"],
            result=result, algorithm="test/1", input_sha256="0" * 64, **values,
        )
    )  # fmt: skip
    announce(session, "installation", at=NOW, organisation_id=device.organisation_id, device_id=device.id)


@pytest.mark.both_databases
def test_the_view_is_the_open_installation_or_nothing_yet(database):
    device = add_device(database)
    with database.transaction() as session:
        empty = load(session, device.id, now=NOW)
        assert empty is not None
        assert (empty.title, empty.vehicle_class, empty.R_va) == ("AB 123 CD · box", "van", None)
        put_result(session, device, {**READY, "R_va": np.eye(3).tolist()}, ended_at=NOW, began_at=NOW)
        put_result(session, device, READY, began_at=NOW + dt.timedelta(hours=1), beginning="moved")
        session.flush()
        view = load(session, device.id, now=NOW)
        assert view is not None
        assert np.array(view.R_va) == pytest.approx(R_VA)
        assert view.sigma == pytest.approx(np.radians([0.6, 0.5, 0.9]))
        assert load(session, "0" * 32, now=NOW) is None


@pytest.mark.both_databases
def test_a_ticket_opens_one_view_for_ten_minutes(database):
    device, other = add_device(database), add_device(database)
    with database.transaction() as session:
        ticket = permission.issue(session, device.organisation_id, device.id, now=NOW)
        _, view3d, secret, device_id, _ = ticket.url.split("/")
        assert (view3d, device_id) == ("view3d", device.id)
        stored = session.get_one(ViewTicket, session.query(ViewTicket.ticket_hash).scalar())
        assert secret not in stored.ticket_hash
        last = NOW + permission.LIFETIME - dt.timedelta(seconds=1)
        assert permission.opens(session, secret, device.id, now=last)
        assert not permission.opens(session, secret, device.id, now=NOW + permission.LIFETIME)
        assert not permission.opens(session, secret, other.id, now=NOW)
        assert not permission.opens(session, secret[:-1] + "~", device.id, now=NOW)
        with pytest.raises(NotFoundError):
            permission.issue(session, "0" * 32, device.id, now=NOW)
        # An open view keeps its ticket alive; an expired one is beyond that, and is cleared away by the next.
        permission.renew(session, secret, now=last)
        assert permission.opens(session, secret, device.id, now=last + permission.LIFETIME / 2)
        permission.renew(session, secret, now=last + permission.LIFETIME)
        assert not permission.opens(session, secret, device.id, now=last + permission.LIFETIME)
        permission.issue(session, other.organisation_id, other.id, now=last + permission.LIFETIME)
        assert session.query(ViewTicket).count() == 1


@contextmanager
def pool_of(database: Database, **options: object) -> Generator[ScenePool]:
    pool = ScenePool(database, clock=lambda: NOW, **options)
    try:
        yield pool
    finally:
        pool.close()


def test_the_pool_shares_evicts_the_least_recent_and_refuses_when_all_are_watched(database):
    a, b, c = (add_device(database).id for _ in range(3))
    with pool_of(database, capacity=2, poll_s=60.0) as pool:
        port = pool.enter(a)
        assert pool.enter(a) == port
        pool.enter(b)
        with pytest.raises(UnavailableError):
            pool.enter(c)
        pool.leave(b)
        pool.enter(c)
        assert pool.running() == (a, c)
        with pytest.raises(NotFoundError):
            pool.leave(c) or pool.enter("0" * 32)
        pool.leave(a)
        assert pool.running() == (a,), "one of two onlookers is still there"


def test_idle_servers_stop_and_give_back_their_threads_and_files(database):
    devices = [add_device(database).id for _ in range(4)]
    now = [0.0]
    with pool_of(database, idle_s=60.0, poll_s=60.0, monotonic=lambda: now[0]) as pool:
        before = (threading.active_count(), len(list(Path("/proc/self/fd").iterdir())))
        for device in devices:
            pool.enter(device)
            pool.leave(device)
        assert threading.active_count() >= before[0] + 4
        now[0] = 59.0
        pool.refresh()
        assert len(pool.running()) == 4
        now[0] = 61.0
        pool.refresh()
        assert pool.running() == ()
        gc.collect()
        eventually(lambda: threading.active_count() <= before[0], within_s=10, what="the threads end")
        assert len(list(Path("/proc/self/fd").iterdir())) <= before[1] + 1


@pytest.mark.both_databases
def test_a_change_row_brings_the_scene_up_to_date(database, monkeypatch):
    shown: list[MountingView] = []
    monkeypatch.setattr(MountingScene, "show", lambda _, view: shown.append(view))
    device, unwatched = add_device(database, result={"status": "insufficient", "reasons": []}), add_device(database)
    with pool_of(database, poll_s=0.02) as pool:
        pool.enter(device.id)
        assert [view.R_va for view in shown] == [None]
        with database.transaction() as session:
            put_result(session, unwatched, READY)
            announce(session, "position", at=NOW, organisation_id=device.organisation_id, device_id=device.id)
        with database.transaction() as session:
            put_result(session, device, READY, began_at=NOW + dt.timedelta(minutes=1))
        eventually(lambda: len(shown) > 1, within_s=10, what="a second frame is shown")
        assert np.array(shown[1].R_va) == pytest.approx(R_VA)
        pool.refresh()
        assert len(shown) == 2, "what others do, and what comes with every upload, does not redraw"


# --- over real sockets -------------------------------------------------------------------------------------------


@contextmanager
def serving(app: object, port: int) -> Generator[uvicorn.Server]:
    config = uvicorn.Config(
        app, host="127.0.0.1", port=port, log_level="error", ws="websockets-sansio", timeout_graceful_shutdown=2
    )  # type: ignore[arg-type]
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve()), daemon=True)
    thread.start()
    eventually(lambda: server.started, within_s=10, what="the server starts")
    try:
        yield server
    finally:
        server.should_exit = True
        thread.join(timeout=10.0)
        assert not thread.is_alive()


def ticket_for(admin: httpx.Client, device: Device) -> str:
    answer = admin.post(f"/api/v1/devices/{device.id}/view-ticket")
    assert answer.status_code == 201, answer.text
    return answer.json()["url"]


def open_socket(base: str, path: str, *, origin: str | None = None, protocol: str = SUBPROTOCOL) -> ClientConnection:
    return connect(
        f"{base.replace('http', 'ws', 1)}{path.rstrip('/')}",
        origin=origin or base, subprotocols=[protocol], compression=None, proxy=None, close_timeout=1,
    )  # type: ignore[arg-type]  # fmt: skip


def drain(client: ClientConnection) -> None:
    while True:
        client.recv(timeout=10)


def status_of_refusal(base: str, path: str, **options: str) -> int:
    with pytest.raises(InvalidStatus) as refusal:
        open_socket(base, path, **options)
    return refusal.value.response.status_code


def test_page_and_socket_end_to_end_through_the_api(app, address, client, admin, settings, database, clock):
    device, other = add_device(database, result=READY), add_device(database)
    path = ticket_for(admin, device)
    port = free_port()
    app.state.viewer_url = f"http://127.0.0.1:{port}"

    down = client.get(path)
    assert (down.status_code, "not running now" in down.text) == (503, True)
    assert status_of_refusal(address, path) == 503

    with serving(create_viewer(settings, clock=clock), port):
        page = client.get(path)
        assert page.status_code == 200
        assert page.content == client_page()
        # A replay is a mere picture: its page leads it.
        replay = client.get(f"{path}?hideViserLogo&playbackPath=x.viser")
        hidden = b"<style>.mantine-Notifications-root,.mantine-Paper-root{display:none!important}</style>"
        assert replay.content.replace(hidden, b"", 1) == client_page()
        assert replay.content != client_page()
        policy = page.headers["content-security-policy"]
        assert "frame-ancestors 'self'" in policy
        assert "'unsafe-eval'" in policy
        assert page.headers["referrer-policy"] == "no-referrer"

        with open_socket(address, path) as browser:
            assert browser.subprotocol == SUBPROTOCOL
            first = browser.recv(timeout=10)
            assert isinstance(first, bytes)
            assert len(first) > 16
        assert status_of_refusal(address, path, origin="https://elsewhere.example") == 403
        # Straight at the viewer, as behind a reverse proxy, it is no different.
        direct = app.state.viewer_url
        assert httpx.get(f"{direct}/healthz").text == "ok"
        secret = path.split("/")[2]
        for wrong in (path.replace(device.id, other.id), path.replace(secret, "A" * len(secret))):
            assert httpx.get(direct + wrong).status_code == 403
            assert status_of_refusal(direct, wrong) == 403
        assert status_of_refusal(direct, path, origin="https://elsewhere.example") == 403
        survivor = open_socket(address, path)
        survivor.recv(timeout=10)

    # The viewer went away: the open socket ends, new ones are refused, and all is well once it is back.
    with pytest.raises(ConnectionClosed):
        drain(survivor)
    assert status_of_refusal(address, path) == 503
    with serving(create_viewer(settings, clock=clock), port), open_socket(address, path) as browser:
        assert browser.recv(timeout=10)

        clock.advance(seconds=permission.LIFETIME.total_seconds())
        assert httpx.get(direct + path).status_code == 403
        assert status_of_refusal(direct, path) == 403
        assert status_of_refusal(address, path) == 403, "the gate in front refuses it too"
        assert client.get(path).status_code == 303


def test_a_view_of_ones_own_walks_through_the_history_and_nobody_else_sees_it(
    app, address, client, admin, settings, database, clock
):
    before = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix() @ R_VA
    moved_at = NOW + dt.timedelta(hours=1)
    with database.transaction() as session:
        device = session.merge(add_device(database))
        put_result(session, device, {**READY, "R_va": before.tolist()}, ended_at=moved_at)
        put_result(session, device, READY, beginning="moved", began_at=moved_at)
        session.flush()
        first, now = (row.id for row in session.query(Installation).order_by(Installation.began_at))
    own, other = (f"{ticket_for(admin, device)}mounting/" for _ in range(2))
    port = free_port()
    app.state.viewer_url = f"http://127.0.0.1:{port}"
    with serving(create_viewer(settings, clock=clock), port):
        picture = client.get(own)
        assert picture.status_code == 200
        assert b".mantine-Notifications-root,.mantine-Paper-root{display:none" in picture.content
        assert client.get(f"{own}state").json()["onlookers"] == 0
        assert client.put(f"{own}state", json={"step": first}).status_code == 404, "nobody has opened it yet"
        with open_socket(address, own) as mine, open_socket(address, other) as theirs:
            mine.recv(timeout=10)
            theirs.recv(timeout=10)
            told = client.get(f"{own}state").json()
            assert (told["onlookers"], told["step"]) == (1, None)
            assert np.array(told["R_va"]) == pytest.approx(R_VA)
            assert {"box", "cones", "gravity", "down"} <= set(told["drawn"])
            assert not {"before", "force", "t_frame"} & set(told["drawn"])
            told = client.put(f"{own}state", json={"step": first}).json()
            assert np.array(told["R_va"]) == pytest.approx(before)
            assert np.array(client.get(f"{other}state").json()["R_va"]) == pytest.approx(R_VA)
            assert "before" in client.put(f"{own}state", json={"step": now, "before": True}).json()["drawn"]
            # The instant under a chart's cursor: how the box sat then, and the force that the chart shows.
            then = {"at": (moved_at - dt.timedelta(seconds=1)).timestamp(), "f": [1.0, 2.0, -9.0]}
            told = client.put(f"{own}state", json=then).json()
            assert np.array(told["R_va"]) == pytest.approx(before)
            assert told["f_v_mps2"] == pytest.approx(before @ then["f"], abs=0.01)
            assert "t_frame" not in told["drawn"]
            later = {"at": moved_at.timestamp() + 1.0, "f": [1.0, 2.0, -9.0], "frame": "v"}
            told = client.put(f"{own}state", json=later).json()
            assert np.array(told["R_va"]) == pytest.approx(R_VA)
            assert told["f_v_mps2"] == [1.0, 2.0, -9.0]
            assert client.put(f"{own}state", json={**later, "f": [None, 1.0, 2.0]}).json()["f_v_mps2"] is None
            # A step that is gone shows how it stands; nonsense is refused; a stranger's ticket opens nothing.
            assert np.array(client.put(f"{own}state", json={"step": "gone"}).json()["R_va"]) == pytest.approx(R_VA)
            for nonsense in ({"proposal": 4}, {"camera": 1}, {"at": -1}, {"f": [1.0]}, {"f": [1e9, 0, 0]}, []):
                assert client.put(f"{own}state", json=nonsense).status_code == 422, nonsense
            secret = own.split("/")[2]
            wrong = own.replace(secret, "A" * len(secret))
            for path in (wrong, f"{wrong}state"):
                assert httpx.get(app.state.viewer_url + path).status_code == 403
            assert status_of_refusal(app.state.viewer_url, wrong) == 403
        eventually(
            lambda: client.get(f"{own}state").json()["onlookers"] == 0, within_s=10, what="nobody looks on any more"
        )
    assert client.get(f"{own}state").status_code == 503


@pytest.mark.both_databases
def test_arrows_follow_each_upload_and_north_the_course(database, settings):
    device = add_device(database, result=READY)
    store = open_store(settings)
    with pool_of(database, store=store, poll_s=60.0) as pool:
        pool.enter(device.id, "me")
        assert pool.state(device.id, "me")["f_v_mps2"] is None
        f_a = zip(("fx", "fy", "fz"), R_VA.T @ [1.0, 0.0, -9.8], strict=True)
        columns = Columns({"t": np.arange(0.0, 2.0, 0.1), **{name: np.full(20, value) for name, value in f_a}})
        store.put("k", columns.to_parquet())
        with database.transaction() as session:
            session.add(DeviceState(device_id=device.id, updated_at=NOW, course_rad=0.5, health={}))
            session.add(
                Batch(
                    organisation_id=device.organisation_id, device_id=device.id, stream="continuous", boot="b",
                    sequence=0, media_type="x", body_sha256="", column_sha256="", blob_key="k", stored_bytes=1,
                    rows=20, t_first_s=0.0, t_last_s=1.9, received_at=NOW, chain_index=0, chain_sha256="",
                )
            )  # fmt: skip
            announce(session, "batch", at=NOW, organisation_id=device.organisation_id, device_id=device.id)
        pool.refresh()
        told = pool.state(device.id, "me")
        assert told["f_v_mps2"] == pytest.approx([1.0, 0.0, -9.8], abs=0.01)
        assert {"force", "t_frame"} <= set(told["drawn"])


@given(course=st.floats(-7.0, 7.0))
def test_north_east_down_in_the_vehicle(course):
    north, east, down = north_east_down(course)
    assert np.cross(north, east) == pytest.approx(down)
    # Heading north, north is ahead; heading east, it is to the left.
    assert north_east_down(0.0)[0] == pytest.approx([1, 0, 0])
    assert north_east_down(np.pi / 2)[0] == pytest.approx([0, -1, 0])
    assert np.array([1.0, 0.0, 0.0]) == pytest.approx(np.cos(course) * north + np.sin(course) * east)


def test_dashes_reach_from_the_origin_to_the_tip():
    lines = dashes(np.array([0.0, 2.0, 0.0]))
    assert lines[0, 0] == pytest.approx([0, 0, 0])
    assert lines[-1, 1] == pytest.approx([0, 2, 0])
    assert (np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) > 0).all()


def test_tickets_need_credentials_and_a_device_of_theirs(client, admin, database):
    device = add_device(database)
    assert client.post(f"/api/v1/devices/{device.id}/view-ticket").status_code == 401
    missing = admin.post(f"/api/v1/devices/{'0' * 32}/view-ticket")
    assert (missing.status_code, missing.json()["code"]) == (404, "not_found")


def test_a_service_without_viewer_says_so(address, client, admin, database):
    path = ticket_for(admin, add_device(database))
    assert client.get(path).status_code == 503
    assert status_of_refusal(address, path) == 503


def test_no_client_can_make_viser_open_a_tunnel(monkeypatch):
    asked = threading.Event()
    tunnels: list[object] = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *args: tunnels.append(args))
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        close_share(server)
        closed = server.request_share_url
        monkeypatch.setattr(server, "request_share_url", lambda: (closed(), asked.set()))
        with open_socket(f"http://127.0.0.1:{server.get_port()}", "/") as client:
            client.recv(timeout=10)
            client.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
            assert asked.wait(10), "the raw message reached the override"
        assert not tunnels
        assert server.request_share_url.__name__  # the server's own method is shadowed, not the class's
    finally:
        server.stop()


@pytest.mark.parametrize(
    ("origin", "host", "forwarded", "allowed"),
    [
        ("http://box.example:8000", "box.example:8000", None, True),
        ("https://box.example", "box.example:443", None, True),
        ("https://box.example", "10.0.0.3:9000", "box.example", True),
        ("https://trusted.example", "box.example", None, True),
        ("https://evil.example", "box.example", None, False),
        ("http://box.example:8001", "box.example:8000", None, False),
        ("null", "box.example", None, False),
        ("file://box.example", "box.example", None, False),
        ("http://box.example:x", "box.example", None, False),
        ("", "", None, False),
    ],
)
def test_origins(origin, host, forwarded, allowed):
    headers = {"origin": origin, "host": host} | ({"x-forwarded-host": forwarded} if forwarded else {})
    assert same_origin(headers, ("https://trusted.example",)) is allowed


def test_the_api_side_loads_neither_viser_nor_scipy():
    code = (
        "import sys, server.view3d.proxy, server.view3d.tickets; print({'viser', 'scipy', 'numba'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
