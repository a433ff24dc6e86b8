"""The queue on disk of the reference client: what it holds survives power cuts, and leaves when it is acknowledged.

A batch is one file ``<stream>/boot-<boot>/<sequence>.batch``: a line of JSON, then the body.  It appears by
renaming a file that is already on disk, so that a file is whole or not there.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from server.uploader import Acknowledgement, NotAdmittedError, Parcel, Stream, Uploader, UploadRefusedError

# Bursts are evidence of a crash: they go first.
_STREAMS: tuple[Stream, ...] = ("burst", "continuous")
_BOOT = re.compile(r"[A-Za-z0-9._-]{1,64}")
_REFUSED = "refused"


class OutboxFullError(OSError):
    """The queue has reached its limit; nothing that was in it is dropped."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a queued batch lies."""

    stream: Stream
    boot: str
    sequence: int
    path: Path


class Outbox:
    """A folder of batches that wait to be acknowledged."""

    def __init__(self, folder: Path, *, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._bytes = sum(path.stat().st_size for path in folder.rglob("*.batch"))

    def put(self, parcel: Parcel) -> None:
        """Keep a batch durably; one that is there already is left as it is."""
        path = self._path(parcel.stream, parcel.boot, parcel.sequence)
        if path.exists():
            return
        head = {"media_type": parcel.media_type, "content_encoding": parcel.content_encoding}
        data = json.dumps(head).encode() + b"\n" + parcel.body
        if self._bytes + len(data) > self._max_bytes:
            raise OutboxFullError(f"{self._folder} holds {self._bytes} bytes, its limit is {self._max_bytes}")
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        fresh = path.with_suffix(f".new-{os.getpid()}")
        with fresh.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        fresh.rename(path)
        for folder in (path.parent, path.parent.parent, self._folder):
            _sync(folder)
        self._bytes += len(data)

    def places(self) -> Iterator[Place]:
        """What is queued: bursts first, each boot in the order of its sequence."""
        for stream in _STREAMS:
            for folder in sorted((self._folder / stream).glob("boot-*")):
                boot = folder.name.removeprefix("boot-")
                for sequence in sorted(int(path.stem) for path in folder.glob("*.batch") if _is_number(path.stem)):
                    yield Place(stream, boot, sequence, self._path(stream, boot, sequence))

    def read(self, place: Place) -> Parcel:
        """A queued batch."""
        head, _, body = place.path.read_bytes().partition(b"\n")
        try:
            said = cast("dict[str, str]", json.loads(head))
            return Parcel(place.stream, place.boot, place.sequence, said["media_type"], said["content_encoding"], body)
        except (ValueError, KeyError, TypeError) as error:
            raise UploadRefusedError(0, f"the queued file is damaged: {error}") from error

    def forget(self, place: Place) -> None:
        """Take a batch out: it is stored elsewhere."""
        try:
            size = place.path.stat().st_size
            place.path.unlink()
        except FileNotFoundError:  # another run of the client was faster
            return
        self._bytes -= size

    def set_aside(self, place: Place, why: str) -> Path:
        """Keep a batch that the service refuses out of the way of the others, and the reason beside it."""
        aside = self._folder / _REFUSED / place.path.relative_to(self._folder).with_suffix(".refused")
        aside.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        aside.with_suffix(".txt").write_text(why + "\n", encoding="utf-8")
        self._bytes -= place.path.stat().st_size
        place.path.rename(aside)
        _sync(aside.parent)
        return aside

    def _path(self, stream: Stream, boot: str, sequence: int) -> Path:
        if _BOOT.fullmatch(boot) is None or sequence < 0:
            raise ValueError(f"{boot!r}/{sequence}: a boot is 1 to 64 of A-Z a-z 0-9 . _ -, a sequence counts from 0")
        # The prefix keeps a boot called ".." where it belongs.
        return self._folder / stream / f"boot-{boot}" / f"{sequence}.batch"


def _is_number(text: str) -> bool:
    return text.isdecimal() and str(int(text)) == text


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@dataclass(slots=True)
class Tally:
    """What became of the queue."""

    acknowledged: int = 0
    duplicates: int = 0
    known: int = 0
    """Not sent: an answer told that the service has them."""
    refused: list[Path] = field(default_factory=list[Path])
    missing: dict[str, list[tuple[int, int]]] = field(default_factory=dict[str, list[tuple[int, int]]])
    """By boot: what the service lacks below what it has, and the queue does not hold."""
    last: Acknowledgement | None = None


def forward(outbox: Outbox, uploader: Uploader) -> Iterator[Tally]:
    """Send what is queued, and what is put there meanwhile; yields after each batch.

    Raises
    ------
    NotAdmittedError
        The service refuses the box; everything stays queued.
    UnreachableError
        The uploader's patience ended; the rest stays queued.
    """
    tally = Tally()
    while waiting := list(outbox.places()):
        stored_below: dict[tuple[Stream, str], int] = {}
        for place in waiting:
            lane = (place.stream, place.boot)
            if place.sequence < stored_below.get(lane, 0):
                outbox.forget(place)
                tally.known += 1
            else:
                answer = _deliver(outbox, uploader, place, tally)
                if answer is not None:
                    stored_below[lane] = answer.next_sequence
                    lacking = tally.missing[f"{place.stream} {place.boot}"] = list(answer.missing)
                    if not lacking:
                        del tally.missing[f"{place.stream} {place.boot}"]
            yield tally


def _deliver(outbox: Outbox, uploader: Uploader, place: Place, tally: Tally) -> Acknowledgement | None:
    try:
        answer = uploader.deliver(outbox.read(place))
    except FileNotFoundError:  # another run of the client was faster
        return None
    except NotAdmittedError:
        raise
    except UploadRefusedError as error:
        tally.refused.append(outbox.set_aside(place, str(error)))
        return None
    outbox.forget(place)
    tally.acknowledged += 1
    tally.duplicates += answer.duplicate
    tally.last = answer
    return answer
