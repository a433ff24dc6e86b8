"""The demo's fleet at work: registers its boxes, drives them, uploads, and remembers where it stopped."""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
import os
import secrets
import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx

from server.demo.boxes import FLEET, Box, Leg, Standpoint, after, first_standpoint, has_ended, next_leg
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.uploader import Uploader, batches

_PAST_BATCH_S, _LIVE_BATCH_S = 60.0, 10.0
_SHORT_UNTIL_S = 120.0
"""The first drive begins with short batches, so that its calibration can be watched."""


class Timeline:
    """A box's clock: runs through the past faster than life, then keeps step with it."""

    def __init__(self, *, started: float, history_s: float, speed: float, now: Callable[[], float]) -> None:
        self._started, self._speed, self._now = started, speed, now
        self.origin = started - history_s
        """Unix time at which it begins."""

    def seconds_until(self, utc: float) -> float:
        """Real seconds until the fleet's clock shows `utc`; negative when that is past."""
        # The replay meets the present after history / (speed - 1); a moment behind that is reached by replay.
        replayed = self._started + (utc - self.origin) / self._speed
        return max(replayed, utc) - self._now()

    def is_live(self, utc: float) -> bool:
        """Whether `utc` is reached at life's own pace."""
        # A millisecond of slack: at speed 1 both sides are the same but for rounding.
        return utc > self._started + (utc - self.origin) / self._speed - 1e-3


class Memory:
    """What one start of the demo leaves for the next, in a file that only its owner can read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._content: dict[str, Any] = (
            json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"seed": secrets.randbelow(10**6)}
        )

    @property
    def seed(self) -> int:
        return int(self._content["seed"])

    def of(self, box: Box) -> dict[str, Any]:
        return self._content.get(box.name, {})

    def keep(self, box: Box, **values: object) -> None:
        with self._lock:
            self._content.setdefault(box.name, {}).update(values)
            temporary = self._path.with_suffix(".new")
            with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
                json.dump(self._content, file)
            temporary.replace(self._path)


class Fleet:
    """All boxes, each in a thread of its own."""

    def __init__(
        self,
        client: httpx.Client,
        admin_token: str,
        memory: Memory,
        timeline_of: Callable[[Box], Timeline],
        stop: threading.Event,
        *,
        boxes: tuple[Box, ...] = FLEET,
    ) -> None:
        self._client, self._memory, self._stop = client, memory, stop
        self._timeline_of = timeline_of
        self._admin = {"Authorization": f"Bearer {admin_token}"}
        self._boxes = boxes

    def run(self) -> None:
        """Drive until told to stop."""
        try:
            for box in self._boxes:
                self._register(box)
        except StoppedError:
            return
        threads = [threading.Thread(target=self._drive, args=(box,), name=box.name) for box in self._boxes]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _register(self, box: Box) -> None:
        if "token" in self._memory.of(box):
            return
        vehicle = {"name": box.vehicle, "plate": box.plate, "vehicle_class": box.vehicle_class, "traffic_side": "right"}
        vehicle_id = self._ask("POST", "/api/v1/vehicles", vehicle)["id"]
        device = self._ask("POST", "/api/v1/devices", {"name": box.name, "vehicle_id": vehicle_id})
        self._memory.keep(box, id=device["id"], token=device["token"], boots=0, references=[])

    def _ask(self, method: str, path: str, document: dict[str, Any]) -> dict[str, Any]:
        while True:
            try:
                answer = self._client.request(method, path, json=document, headers=self._admin)
            except httpx.TransportError:
                self._wait(1.0)
                continue
            if answer.status_code < 500:
                answer.raise_for_status()
                return answer.json()
            self._wait(1.0)

    def _drive(self, box: Box) -> None:
        standpoint = self._standpoint(box)
        try:
            while not has_ended(box, standpoint):
                self._wait(max(self._timeline_of(box).seconds_until(standpoint.utc), 0.0))
                standpoint = self._upload(box, next_leg(box, standpoint, seed=self._seed(box)))
        except StoppedError:
            return

    def _seed(self, box: Box) -> int:
        return self._memory.seed + 1000 * (zlib.crc32(box.name.encode()) % 1000)

    def _standpoint(self, box: Box) -> Standpoint:
        kept = self._memory.of(box).get("standpoint")
        if kept is None:
            return first_standpoint(box, self._timeline_of(box).origin)
        standpoint = Standpoint(**kept)
        return dataclasses.replace(standpoint, utc=max(standpoint.utc, self._timeline_of(box).origin))

    def _upload(self, box: Box, leg: Leg) -> Standpoint:
        boots = int(self._memory.of(box)["boots"])
        self._memory.keep(box, boots=boots + 1)
        uploader = Uploader(
            self._client, self._memory.of(box)["token"], f"demo-{boots}", wait=self._wait, encoding=box.encoding
        )
        standpoint = after(leg, 0.0)
        timeline = self._timeline_of(box)
        known_from = 0
        for sequence, batch in enumerate(self._cut(leg, timeline)):
            t_last = float(batch.values["t"][-1])
            self._wait(max(timeline.seconds_until(leg.began_utc + t_last), 0.0))
            known_from = self._tell_truth(box, leg, leg.began_utc + t_last, known_from)
            uploader.send(sequence, batch)
            standpoint = after(leg, t_last)
            self._memory.keep(box, standpoint=dataclasses.asdict(standpoint))
        return standpoint

    def _cut(self, leg: Leg, timeline: Timeline) -> list[Columns]:
        """Long batches for the past, short ones where somebody watches."""
        parts: list[Columns] = []
        for part in batches(from_drive(leg.drive), _PAST_BATCH_S):
            t_last = float(part.values["t"][-1])
            watched = timeline.is_live(leg.began_utc + t_last) or (leg.number == 0 and t_last <= _SHORT_UNTIL_S)
            parts.extend(batches(part, _LIVE_BATCH_S) if watched else [part])
        return parts

    def _tell_truth(self, box: Box, leg: Leg, utc: float, known_from: int) -> int:
        """Let the service show the true mounting beside the estimate, from the moment on at which it holds."""
        known = sum(since <= utc for since, _ in leg.mountings)
        if known > known_from:
            references: list[dict[str, Any]] = list(self._memory.of(box)["references"])
            for since, R_va in leg.mountings[known_from:known]:
                if not references or references[-1]["R_va"] != R_va.tolist():
                    moment = dt.datetime.fromtimestamp(since, dt.UTC).isoformat()
                    references.append({"from": moment, "R_va": R_va.tolist()})
            self._ask("PUT", f"/api/v1/devices/{self._memory.of(box)['id']}/reference", {"mountings": references})
            self._memory.keep(box, references=references)
        return known

    def _wait(self, seconds: float) -> None:
        if self._stop.wait(seconds):
            raise StoppedError


class StoppedError(Exception):
    """The demo was told to stop while it waited."""
