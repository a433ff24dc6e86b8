"""Clients that stop in the middle hold no slot: they are cut off in time, and others are served the while."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time

import httpx
import pytest
import sqlalchemy as sa

from server import patience
from server.app import CONCURRENT_UPLOADS
from server.ingest import body as reading
from server.models import Batch

BODY = json.dumps({"columns": {"t": [0.0], "temp": [20.0]}}).encode()
MANY = 5 * CONCURRENT_UPLOADS


def begun(address: str, token: str, sequence: int, *, promised: int = 1000, sent: bytes = b"") -> socket.socket:
    """An upload that was begun and not finished."""
    host, port = address.removeprefix("http://").split(":")
    connection = socket.create_connection((host, int(port)), 10.0)
    head = [
        "POST /api/v1/batches HTTP/1.1",
        f"Host: {host}",
        f"Authorization: Bearer {token}",
        f"Idempotency-Key: slow/{sequence}",
        "Content-Type: application/json",
        f"Content-Length: {promised}",
    ]
    connection.sendall("\r\n".join([*head, "", ""]).encode() + sent)
    return connection


def answer_of(connection: socket.socket) -> bytes:
    """Head and content of the answer; the connection is closed."""
    with connection:
        connection.settimeout(20.0)
        answer = b""
        while b"}" not in answer and (more := connection.recv(65536)):
            answer += more
    return answer


def send(client: httpx.Client, token: str, key: str) -> httpx.Response:
    headers = {"Authorization": f"Bearer {token}", "Idempotency-Key": key, "Content-Type": "application/json"}
    return client.post("/api/v1/batches", content=BODY, headers=headers)


@pytest.fixture
def stored(database):
    def count() -> int:
        with database.reading() as session:
            return session.scalar(sa.select(sa.func.count(Batch.id)))

    return count


def test_a_body_that_stops_is_cut_off_and_holds_up_nobody(address, client, make_device, monkeypatch, stored):
    monkeypatch.setattr(reading, "BODY_TIMEOUT_S", 3.0)
    _, token = make_device()
    halves = [begun(address, token, number, sent=BODY[:10]) for number in range(MANY)]
    began = time.monotonic()
    for number in range(CONCURRENT_UPLOADS + 1):
        assert send(client, token, f"good/{number}").status_code == 202
    assert time.monotonic() - began < 3.0, "others waited for the slow ones"
    answers = [answer_of(connection) for connection in halves]
    assert all(answer.startswith(b"HTTP/1.1 408 ") and b'"code":"body_timeout"' in answer for answer in answers)
    assert stored() == CONCURRENT_UPLOADS + 1


def test_one_byte_at_a_time_does_not_live_longer(address, make_device, monkeypatch, stored):
    monkeypatch.setattr(reading, "BODY_TIMEOUT_S", 1.0)
    connection = begun(address, make_device()[1], 0)
    connection.settimeout(20.0)
    over = threading.Event()

    def drip() -> None:
        while not over.wait(0.05):
            try:
                connection.sendall(b" ")
            except OSError:
                return

    dripping = threading.Thread(target=drip)
    dripping.start()
    answer = answer_of(connection)
    over.set()
    dripping.join()
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert stored() == 0


def test_connections_that_break_leave_nothing(address, client, make_device, stored):
    _, token = make_device()
    for number in range(MANY):
        connection = begun(address, token, number, promised=len(BODY), sent=BODY[:-1])
        if number % 2:  # a reset instead of an end
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        connection.close()
    for number in range(CONCURRENT_UPLOADS + 1):
        assert send(client, token, f"good/{number}").status_code == 202
    assert stored() == CONCURRENT_UPLOADS + 1


def test_an_answer_that_nobody_fetches(address, client, make_device, stored):
    """The batch is stored; the box sends it again and is told so."""
    _, token = make_device()
    for number in range(MANY):
        begun(address, token, number, promised=len(BODY), sent=BODY).close()
    for number in range(MANY):
        assert send(client, token, f"slow/{number}").status_code == 202
    assert stored() == MANY


def closed_within(connection: socket.socket, seconds: float) -> bytes:
    """What came until the other side closed."""
    connection.settimeout(seconds)
    answer = b""
    while more := connection.recv(65536):
        answer += more
    return answer


def test_a_head_that_does_not_end_is_cut_off(address, client, make_device, monkeypatch):
    """Nothing sent, half a head, a head that drips, half a second head on a connection that was served."""
    monkeypatch.setattr(patience, "HEAD_S", 0.5)
    _, token = make_device()
    host, port = address.removeprefix("http://").split(":")
    opened = [socket.create_connection((host, int(port)), 10.0) for _ in range(4)]
    silent, half, dripping, second = opened
    half.sendall(b"POST /api/v1/batches HTTP/1.1\r\nHost: x\r\n")
    second.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
    while b"ok" not in second.recv(65536):
        pass
    second.sendall(b"GET /healthz HTTP/1.1\r\nHost: x\r\nX-Slow: ")
    over = threading.Event()

    def drip() -> None:
        while not over.wait(0.02):
            try:
                dripping.sendall(b"G")
            except OSError:
                return

    thread = threading.Thread(target=drip)
    thread.start()
    assert send(client, token, "good/0").status_code == 202
    try:
        for connection in (silent, half, second):
            with connection:
                assert closed_within(connection, 20.0) == b""
        with dripping, contextlib.suppress(ConnectionResetError):
            closed_within(dripping, 20.0)
    finally:
        over.set()
        thread.join()


def test_a_slow_answer_and_a_slow_body_are_not_a_slow_head(address, make_device, monkeypatch):
    """A head that came in time may be followed by a body that takes longer, and by further requests."""
    monkeypatch.setattr(patience, "HEAD_S", 0.3)
    connection = begun(address, make_device()[1], 0, promised=len(BODY), sent=BODY[:10])
    threading.Event().wait(0.6)
    connection.sendall(BODY[10:])
    assert answer_of(connection).startswith(b"HTTP/1.1 202 ")
