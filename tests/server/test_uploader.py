"""The reference client: when it tries again, when it stops, and what its queue on disk keeps."""

from __future__ import annotations

import json

import httpx
import numpy as np
import pytest

from server.cli.main import main
from server.formats.columns import Columns
from server.formats.drive import write_drive_csv
from server.outbox import Outbox, OutboxFullError, forward
from server.uploader import (
    ENCODINGS,
    NotAdmittedError,
    Parcel,
    UnreachableError,
    Uploader,
    UploadRefusedError,
    batches,
    encode,
)

MEGABYTE = 1024 * 1024


def columns(rows: int = 30) -> Columns:
    return Columns({"t": np.arange(rows) * 1.0} | {name: np.arange(rows) * 0.01 for name in ("fx", "fy", "fz")})


def parcel(sequence: int = 0, *, stream="continuous", boot="b") -> Parcel:
    return Parcel(stream, boot, sequence, *encode(columns(), "compact"))


class Service:
    """Answers from a list, then acknowledges; remembers what it was asked."""

    def __init__(self, *answers: httpx.Response | Exception) -> None:
        self.answers = list(answers)
        self.asked: list[httpx.Request] = []
        self.waits: list[float] = []
        self.stored: set[int] = set()

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.asked.append(request)
        answer = self.answers.pop(0) if self.answers else None
        if isinstance(answer, Exception):
            raise answer
        return answer or self.acknowledge(int(request.headers["idempotency-key"].rpartition("/")[2]))

    def acknowledge(self, sequence: int) -> httpx.Response:
        duplicate = sequence in self.stored
        self.stored.add(sequence)
        lowest = next(n for n in range(len(self.stored) + 1) if n not in self.stored)
        gaps = [n for n in range(max(self.stored)) if n not in self.stored]
        return httpx.Response(
            202,
            json={
                "batch_id": "x",
                "duplicate": duplicate,
                "next_sequence": lowest,
                "missing": [[n, n] for n in gaps],
                "server_time": "2026-03-01T12:00:00Z",
                "requests": [],
            },
        )

    def uploader(self, **options) -> Uploader:
        client = httpx.Client(base_url="http://box.test", transport=httpx.MockTransport(self))
        return Uploader(client, "token", "b", wait=self.waits.append, **options)


def test_it_tries_again_while_that_can_help_and_waits_longer_each_time():
    service = Service(*[httpx.ConnectError("gone")] * 12, httpx.Response(500), httpx.Response(408))
    answer = service.uploader().deliver(parcel(0))
    assert answer.next_sequence == 1
    assert len(service.asked) == 15
    assert len({request.content for request in service.asked}) == 1
    limits = [min(2.0**n, 300.0) for n in range(14)]
    assert all(0.0 <= wait <= limit for wait, limit in zip(service.waits, limits, strict=True))
    assert len(set(service.waits)) == len(service.waits)


@pytest.mark.parametrize(
    ("headers", "seconds"),
    [
        ({"Retry-After": "17"}, 17.0),
        ({"Retry-After": "Sun, 01 Mar 2026 12:00:40 GMT", "Date": "Sun, 01 Mar 2026 12:00:10 GMT"}, 30.0),
        ({"Retry-After": "Sun, 01 Mar 2026 12:00:40 GMT"}, 0.0),
        ({"Retry-After": "soon"}, 0.0),
        ({}, 0.0),
    ],
)
def test_it_waits_as_long_as_it_is_told(headers, seconds):
    service = Service(httpx.Response(429, headers=headers))
    service.uploader().deliver(parcel())
    assert seconds <= service.waits[0] <= seconds + 1.0


@pytest.mark.parametrize(
    ("status", "error"), [(401, NotAdmittedError), (403, NotAdmittedError), (409, UploadRefusedError)]
)
def test_it_stops_where_trying_again_is_useless(status, error):
    service = Service(httpx.Response(status, text="because"))
    with pytest.raises(error, match="because"):
        service.uploader().deliver(parcel())
    assert service.waits == []


def test_its_patience_ends():
    service = Service(*[httpx.ConnectError("gone")] * 100)
    with pytest.raises(UnreachableError, match="given up"):
        service.uploader(patience_s=30.0).deliver(parcel())
    assert sum(service.waits) == pytest.approx(30.0)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_same_batch_is_the_same_bytes(encoding):
    assert encode(columns(), encoding) == encode(columns(), encoding)


def test_the_queue_survives_and_is_worked_off_in_order(tmp_path):
    outbox = Outbox(tmp_path, max_bytes=MEGABYTE)
    for sequence in (10, 2, 0, 1):
        outbox.put(parcel(sequence))
    outbox.put(parcel(0, stream="burst"))
    outbox.put(parcel(0, boot=".."))
    assert not list(tmp_path.glob("**/*.new*"))
    assert all(path.is_relative_to(tmp_path / "continuous") for path in tmp_path.glob("continuous/**/*.batch"))
    again = Outbox(tmp_path, max_bytes=MEGABYTE)
    order = [(place.stream, place.boot, place.sequence) for place in again.places()]
    assert order == [("burst", "b", 0), ("continuous", "..", 0), *[("continuous", "b", n) for n in (0, 1, 2, 10)]]
    assert again.read(next(iter(again.places()))) == parcel(0, stream="burst")
    service = Service()
    (*_, tally) = forward(again, service.uploader())
    assert tally.acknowledged == 6
    assert list(again.places()) == []
    assert tally.missing == {"continuous b": [(n, n) for n in range(3, 10)]}


def test_what_the_service_has_is_not_sent_again(tmp_path):
    outbox = Outbox(tmp_path, max_bytes=MEGABYTE)
    for sequence in range(10):
        outbox.put(parcel(sequence))
    service = Service()
    service.stored = {0, 1, 2, 3, 6, 7, 8, 9}
    (*_, tally) = forward(outbox, service.uploader())
    sent = [request.headers["idempotency-key"] for request in service.asked]
    assert sent == ["b/0", "b/4", "b/5"]
    assert (tally.acknowledged, tally.duplicates, tally.known, tally.missing) == (3, 1, 7, {})
    assert list(outbox.places()) == []


def test_a_refused_batch_is_kept_aside_and_the_rest_goes_on(tmp_path):
    outbox = Outbox(tmp_path, max_bytes=MEGABYTE)
    outbox.put(parcel(0))
    outbox.put(parcel(1))
    damaged = tmp_path / "continuous" / "boot-b" / "2.batch"
    damaged.write_bytes(b"not json\nbody")
    service = Service(httpx.Response(422, text="t goes wrong"))
    (*_, tally) = forward(outbox, service.uploader())
    assert tally.acknowledged == 1
    first, second = tally.refused
    assert first.read_bytes().endswith(parcel(0).body)
    assert "t goes wrong" in first.with_suffix(".txt").read_text()
    assert "damaged" in second.with_suffix(".txt").read_text()


def test_a_box_that_is_not_admitted_keeps_everything(tmp_path):
    outbox = Outbox(tmp_path, max_bytes=MEGABYTE)
    outbox.put(parcel(0))
    with pytest.raises(NotAdmittedError):
        list(forward(outbox, Service(httpx.Response(401)).uploader()))
    assert len(list(outbox.places())) == 1


def test_a_full_queue_takes_nothing_and_drops_nothing(tmp_path):
    outbox = Outbox(tmp_path, max_bytes=len(parcel(0).body) + 100)
    outbox.put(parcel(0))
    outbox.put(parcel(0))
    with pytest.raises(OutboxFullError):
        outbox.put(parcel(1))
    with pytest.raises(OutboxFullError):
        Outbox(tmp_path, max_bytes=10).put(parcel(2))
    assert [place.sequence for place in outbox.places()] == [0]


@pytest.mark.parametrize("encoding", ["parquet", "compact"])
def test_the_command_stores_forwards_and_resumes(encoding, tmp_path, capsys, address, make_device):
    _, token = make_device()
    drive, queue = tmp_path / "drive.csv", tmp_path / "queue"
    write_drive_csv(drive, columns(95))
    options = ["--seconds", "10", "--queue", str(queue), "--encoding", encoding, "--json"]
    assert main(["upload", str(drive), "--store-only", *options]) == 0
    assert json.loads(capsys.readouterr().out)["batches"] == 10
    assert len(list(queue.glob("continuous/*/*.batch"))) == 10
    to = ["--url", address, "--token", token]
    assert main(["upload", *to, *options]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["acknowledged"], said["duplicates"], said["refused"]) == (10, 0, [])
    assert list(queue.glob("continuous/*/*.batch")) == []
    # The same file again: one batch asks, and the answer tells that the service has the rest.
    assert main(["upload", str(drive), *to, *options]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["acknowledged"], said["duplicates"], said["known"], said["rows"]) == (1, 1, 9, 95)


def test_the_command_ends_with_1_when_nobody_answers_and_keeps_the_queue(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda _: None)
    drive, queue = tmp_path / "drive.csv", tmp_path / "queue"
    write_drive_csv(drive, columns())
    status = main(
        [
            "upload",
            str(drive),
            "--url",
            "http://127.0.0.1:9",
            "--token",
            "t",
            "--queue",
            str(queue),
            "--give-up-after",
            "5",
        ]
    )
    assert status == 1
    assert "given up" in capsys.readouterr().err
    assert list(queue.glob("continuous/*/*.batch"))


def test_the_pieces_of_a_recording_are_the_recording():
    whole = columns(95)
    parts = list(batches(whole, 10.0))
    assert sum(part.rows for part in parts) == 95
