"""One viser server per box that somebody looks at, brought up when needed and stopped when idle."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import structlog
import viser
from sqlalchemy import func, select

from server.database import Database
from server.edge import Clock
from server.errors import NotFoundError, UnavailableError
from server.models import Change
from server.view3d.scene import MountingScene
from server.view3d.view import load

# Rows of these kinds come with every upload and never change what the scene shows.
_QUIET_KINDS = ("batch", "position", "trip")

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Stage:
    """A running viser server, its scene, and who looks at it."""

    server: viser.ViserServer
    scene: MountingScene
    onlookers: int = 0
    left_at: float = 0.0


class ScenePool:
    """Viser servers on loopback, least recently used last out; a thread keeps their scenes in step with the rows.

    `monotonic` is the clock of idleness, s.
    """

    def __init__(
        self,
        database: Database,
        *,
        clock: Clock,
        capacity: int = 64,
        idle_s: float = 60.0,
        poll_s: float = 0.3,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._clock = clock
        self._capacity = capacity
        self._idle_s = idle_s
        self._poll_s = poll_s
        self._monotonic = monotonic
        self._stages: OrderedDict[str, _Stage] = OrderedDict()
        # Held while a stage is built and while changes are applied: a change that commits in between is
        # seen either by the load or by the tail that follows it.
        self._lock = threading.Lock()
        self._seen = 0
        self._closing = threading.Event()
        self._tail = threading.Thread(target=self._follow, name="view3d-tail", daemon=True)
        self._tail.start()

    def enter(self, device_id: str) -> int:
        """Add an onlooker; the loopback port of the box's server, which runs until he and all others `leave`.

        Raises when the box does not exist or no place is left.
        """
        with self._lock:
            stage = self._stages.get(device_id)
            if stage is None:
                self._make_room()
                stage = self._stages[device_id] = self._build(device_id)
            self._stages.move_to_end(device_id)
            stage.onlookers += 1
            return stage.server.get_port()

    def leave(self, device_id: str) -> None:
        """Take an onlooker away; the server stays for a while in case he comes back."""
        with self._lock:
            stage = self._stages.get(device_id)
            if stage is not None:
                stage.onlookers -= 1
                stage.left_at = self._monotonic()

    def running(self) -> tuple[str, ...]:
        """The boxes that have a server now, least recently opened first."""
        with self._lock:
            return tuple(self._stages)

    def close(self) -> None:
        """Stop the thread and every server."""
        self._closing.set()
        self._tail.join(timeout=10.0)
        with self._lock:
            for stage in self._stages.values():
                stage.server.stop()
            self._stages.clear()

    def _build(self, device_id: str) -> _Stage:
        with self._database.reading() as session:
            if not self._stages:
                # Nobody followed the table meanwhile; what is there now is in what is loaded next.
                self._seen = session.scalar(select(func.max(Change.id))) or 0
            view = load(session, device_id, now=self._clock())
        if view is None:
            raise NotFoundError(f"no device {device_id}")
        server = viser.ViserServer(host="127.0.0.1", port=0, label=None, verbose=False)
        close_share(server)
        scene = MountingScene(server)
        scene.show(view)
        return _Stage(server, scene)

    def _make_room(self) -> None:
        if len(self._stages) < self._capacity:
            return
        for device_id, stage in self._stages.items():
            if stage.onlookers == 0:
                self._stages.pop(device_id).server.stop()
                return
        raise UnavailableError(f"{self._capacity} 3D views are open, no more at once")

    def _follow(self) -> None:
        while not self._closing.wait(self._poll_s):
            try:
                self.refresh()
            except Exception:  # noqa: BLE001  the thread must outlive a database that is away for a while
                _log.exception("view3d_refresh_failed")

    def refresh(self) -> None:
        """Apply the changes since the last look, and stop servers that nobody looked at for a while."""
        with self._lock:
            now = self._monotonic()
            for device_id, stage in list(self._stages.items()):
                if stage.onlookers == 0 and now - stage.left_at >= self._idle_s:
                    self._stages.pop(device_id).server.stop()
            if not self._stages:
                return
            with self._database.reading() as session:
                newest = session.scalar(select(func.max(Change.id))) or 0
                if newest == self._seen:
                    return
                changed = session.scalars(
                    select(Change.device_id)
                    .where(Change.id > self._seen, Change.id <= newest)
                    .where(Change.kind.not_in(_QUIET_KINDS), Change.device_id.in_(self._stages))
                    .distinct()
                ).all()
                views = [(device_id, load(session, device_id, now=self._clock())) for device_id in changed if device_id]
            for device_id, view in views:
                if view is not None:
                    self._stages[device_id].scene.show(view)
            self._seen = newest


def close_share(server: viser.ViserServer) -> None:
    """Keep viser from opening a tunnel to an outside host; hiding its button does not stop a client that asks."""

    def refused(verbose: bool = True) -> str | None:
        del verbose
        _log.warning("view3d_share_refused")
        return None

    server.request_share_url = refused
