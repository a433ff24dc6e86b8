"""Clients that stop in the middle hold no slot: they are cut off in time, and others are served the while."""

from __future__ import annotations

import json
import socket
import threading
import time

import httpx
import pytest
import sqlalchemy as sa

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
