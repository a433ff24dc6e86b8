"""One viser server per box that somebody looks at, brought up when needed and stopped when idle.

Whoever walks through a box's history gets a server of his own: what he chooses is nobody else's picture.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import structlog
import viser
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from nav_core.typing import Floats
from server.database import Database
from server.edge import Clock
from server.errors import NotFoundError, UnavailableError
from server.installations.level import Feel, Source, feel, level_of, sources
from server.models import Change, DeviceState
from server.store import BlobStore
from server.view3d.live import Live, LiveParts
from server.view3d.scene import MountingScene
from server.view3d.uncertainty import axis_ellipse
from server.view3d.view import Choice, Matrix, MountingView, Triad, load, load_step, proposal_view

# Rows of these kinds come with every upload and never change what the scene shows.
_QUIET_KINDS = ("batch", "position", "trip")

_log = structlog.get_logger(__name__)


class Subject(NamedTuple):
    """What a server is for: a box, for everybody who looks at it or for the holder of one ticket."""

    device_id: str
    owner: str | None = None


@dataclass(slots=True)
class _Stage:
    """A running viser server, its scene, and who looks at it."""

    server: viser.ViserServer
    scene: MountingScene
    onlookers: int = 0
    left_at: float = 0.0
    live: LiveParts | None = None
    """Arrows and north; only on a stage of one's own, like the choice."""
    choice: Choice = field(default_factory=Choice)


@dataclass(frozen=True, slots=True)
class _News:
    """What was read for a stage, outside its scene."""

    view: MountingView
    f_v: Triad | None = None
    """Specific force, V-frame, m/s²."""
    course: float | None = None


class ScenePool:
    """Viser servers on loopback, least recently used last out; a thread keeps their scenes in step with the rows.

    `monotonic` is the clock of idleness, s.
    """

    def __init__(
        self,
        database: Database,
        *,
        clock: Clock,
        store: BlobStore | None = None,
        capacity: int = 64,
        idle_s: float = 60.0,
        poll_s: float = 0.3,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._clock = clock
        self._store = store
        self._capacity = capacity
        self._idle_s = idle_s
        self._poll_s = poll_s
        self._monotonic = monotonic
        self._stages: OrderedDict[Subject, _Stage] = OrderedDict()
        # Held while a stage is built and while changes are applied: a change that commits in between is
        # seen either by the load or by the tail that follows it.
        self._lock = threading.Lock()
        self._seen = 0
        self._closing = threading.Event()
        self._tail = threading.Thread(target=self._follow, name="view3d-tail", daemon=True)
        self._tail.start()

    def enter(self, device_id: str, owner: str | None = None) -> int:
        """Add an onlooker; the loopback port of the box's server, which runs until he and all others `leave`.

        Raises when the box does not exist or no place is left.
        """
        subject = Subject(device_id, owner)
        with self._lock:
            stage = self._stages.get(subject)
            if stage is None:
                self._make_room()
                stage = self._stages[subject] = self._build(subject)
            self._stages.move_to_end(subject)
            stage.onlookers += 1
            return stage.server.get_port()

    def leave(self, device_id: str, owner: str | None = None) -> None:
        """Take an onlooker away; the server stays for a while in case he comes back."""
        with self._lock:
            stage = self._stages.get(Subject(device_id, owner))
            if stage is not None:
                stage.onlookers -= 1
                stage.left_at = self._monotonic()

    def choose(self, device_id: str, owner: str, choice: Choice) -> None:
        """Show something else of the box's history to the owner of this server."""
        with self._lock:
            stage = self._stages.get(Subject(device_id, owner))
            if stage is None:
                raise NotFoundError("The 3D view is not open")
            with self._database.reading() as session:
                seen = self._read(session, device_id, choice)
            stage.choice = choice
            self._apply(stage, seen)

    def state(self, device_id: str, owner: str) -> dict[str, Any]:
        """What the owner's server shows, in plain words for the page around it, and for tests."""
        with self._lock:
            stage = self._stages.get(Subject(device_id, owner))
            if stage is None:
                return {"onlookers": 0, "step": None, "drawn": []}
            return {"onlookers": stage.onlookers, "step": stage.choice.step, **_told(stage)}

    def running(self) -> tuple[str, ...]:
        """The boxes that have a server now, least recently opened first."""
        with self._lock:
            return tuple(subject.device_id for subject in self._stages)

    def close(self) -> None:
        """Stop the thread and every server."""
        self._closing.set()
        self._tail.join(timeout=10.0)
        with self._lock:
            for stage in self._stages.values():
                stage.server.stop()
            self._stages.clear()

    def _build(self, subject: Subject) -> _Stage:
        own = subject.owner is not None
        with self._database.reading() as session:
            if not self._stages:
                # Nobody followed the table meanwhile; what is there now is in what is loaded next.
                self._seen = session.scalar(select(func.max(Change.id))) or 0
            if own:
                news = self._read(session, subject.device_id, Choice())
            else:
                view = load(session, subject.device_id, now=self._clock())
                news = None if view is None else _News(view)
        if news is None:
            raise NotFoundError(f"no device {subject.device_id}")
        server = viser.ViserServer(host="127.0.0.1", port=0, label=None, verbose=False)
        close_share(server)
        stage = _Stage(server, MountingScene(server, bare=own), live=LiveParts(server) if own else None)
        self._apply(stage, news)
        return stage

    def _read(self, session: Session, device_id: str, choice: Choice) -> _News | None:
        """Everything that a stage of one's own shows."""
        view = load_step(session, device_id, choice, now=self._clock())
        if view is None:
            return None
        if choice.at is not None:
            # Where north was then nobody told: it is not drawn.
            return _News(view, choice.f if choice.f_in_vehicle else _turned(view.R_va, choice.f))
        state = session.get(DeviceState, device_id)
        felt = self._feel(sources(session, device_id))
        if choice.proposal is not None and felt is not None:
            level = level_of(felt)
            if level is not None and level.choices:
                view = proposal_view(view, level.choices[choice.proposal].tolist())
        f_a = None if felt is None else felt.f_a
        return _News(view, _turned(view.R_va, f_a), None if state is None else state.course_rad)

    def _feel(self, found: list[Source]) -> Feel | None:
        return None if self._store is None else feel(self._store, found)

    def _apply(self, stage: _Stage, news: _News | None) -> None:
        if news is None:
            return
        stage.scene.show(news.view)
        if stage.live is not None:
            stage.live.show(Live(news.f_v, news.course), news.view.vehicle_class)

    def _make_room(self) -> None:
        if len(self._stages) < self._capacity:
            return
        for subject, stage in self._stages.items():
            if stage.onlookers == 0:
                self._stages.pop(subject).server.stop()
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
            for subject, stage in list(self._stages.items()):
                if stage.onlookers == 0 and now - stage.left_at >= self._idle_s:
                    self._stages.pop(subject).server.stop()
            if not self._stages:
                return
            with self._database.reading() as session:
                newest = session.scalar(select(func.max(Change.id))) or 0
                if newest == self._seen:
                    return
                news = self._news(session, newest)
            for subject, seen in news:
                self._apply(self._stages[subject], seen)
            self._seen = newest

    def _news(self, session: Session, newest: int) -> list[tuple[Subject, _News | None]]:
        """What changed of the boxes that somebody looks at; arrows follow every upload, the rest only estimates."""
        watched = {subject.device_id for subject in self._stages}
        changed = session.execute(
            select(Change.device_id, Change.kind)
            .where(Change.id > self._seen, Change.id <= newest, Change.device_id.in_(watched))
            .distinct()
        ).all()
        moving = {device_id for device_id, _ in changed}
        estimated = {device_id for device_id, kind in changed if kind not in _QUIET_KINDS}
        found: list[tuple[Subject, _News | None]] = []
        for subject, stage in self._stages.items():
            if stage.live is not None and subject.device_id in moving:
                found.append((subject, self._read(session, subject.device_id, stage.choice)))
            elif stage.live is None and subject.device_id in estimated:
                view = load(session, subject.device_id, now=self._clock())
                found.append((subject, None if view is None else _News(view)))
        return found


def _turned(R_va: Matrix | None, f_a: Floats | Triad | None) -> Triad | None:
    """Into the vehicle's axes, to a hundredth: what differs by less is drawn the same."""
    if R_va is None or f_a is None:
        return None
    x, y, z = (np.array(R_va) @ f_a).round(2).tolist()
    return x, y, z


def _told(stage: _Stage) -> dict[str, Any]:
    """What a stage draws: names of its parts, and the figures that give them their shape."""
    view = stage.scene.shown
    live = None if stage.live is None else stage.live.shown
    drawn = ["vehicle", "v_frame"]
    cones = None
    if view is not None:
        drawn += ["box", "a_frame"] if view.R_va is not None else ["unknown"]
        drawn += ["before"] if view.before is not None else []
        drawn += ["reference"] if view.reference is not None else []
        if view.R_va is not None and view.sigma is not None:
            drawn.append("cones")
            sigma = np.array(view.sigma)
            halves = [axis_ellipse(axis, sigma)[0] for axis in np.array(view.R_va).T]
            cones = [np.degrees(half).round(3).tolist() for half in halves]
    if live is not None:
        drawn += ["gravity", "t_frame" if live.course is not None else "down"]
        drawn += ["force"] if live.f_v is not None else []
    return {
        "drawn": drawn,
        "R_va": None if view is None else view.R_va,
        "cones_deg": cones,
        "f_v_mps2": None if live is None else live.f_v,
    }


def close_share(server: viser.ViserServer) -> None:
    """Keep viser from opening a tunnel to an outside host; hiding its button does not stop a client that asks."""

    def refused(verbose: bool = True) -> str | None:
        del verbose
        _log.warning("view3d_share_refused")
        return None

    server.request_share_url = refused
