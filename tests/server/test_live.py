from __future__ import annotations

import asyncio
import datetime as dt
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Self

import httpx
import pytest
import sqlalchemy as sa

from server.live import routes
from server.live.changes import _append, announce
from server.live.hub import QUEUE, LiveHub
from server.models import AuditEntry, Change, Organisation
from tests.e2e.service import eventually


@pytest.fixture
def tell(database, organisation, clock):
    """Announce changes in a transaction of their own; gives their ids."""

    def tell(*kinds: str, organisation_id: str | None = None, **data) -> list[int]:
        with database.transaction() as session:
            for kind in kinds:
                announce(
                    session, kind, at=clock(), organisation_id=organisation_id or organisation.id,
                    device_id="d" * 32, vehicle_id=None, data=data,
                )  # fmt: skip
        with database.reading() as session:
            return [change.id for change in session.query(Change).order_by(Change.id)][-len(kinds) :]

    return tell


@pytest.mark.both_databases
def test_ids_rise_in_the_order_of_commit(database, organisation, clock):
    def tell(session, kind):
        announce(session, kind, at=clock(), organisation_id=organisation.id)

    def another():
        with database.transaction() as session:
            tell(session, "later")

    def waits() -> bool:
        with database.glance() as connection:
            return bool(
                connection.scalar(sa.text("SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"))
            )

    with ThreadPoolExecutor(1) as pool:
        with database.transaction() as session:
            tell(session, "first")
            _append(session)  # as before a commit, which here takes its time
            begun = pool.submit(another)
            if database.engine.dialect.name == "postgresql":
                eventually(waits, within_s=20, what="the other transaction waits for the lock")
            tell(session, "second")
        begun.result(20)
    with database.reading() as session:
        kinds = session.scalars(sa.select(Change.kind).order_by(Change.id)).all()
    assert kinds == ["first", "second", "later"]


class Stream:
    """A browser's view of the stream, read line by line."""

    def __init__(self, client: httpx.Client, **headers: str) -> None:
        self._context = client.stream("GET", "/api/v1/live", headers=headers, timeout=20.0)

    def __enter__(self) -> Self:
        self.answer = self._context.__enter__()
        self._lines = self.answer.iter_lines()
        assert next(self._lines).startswith("retry: ")
        assert next(self._lines) == ""
        return self

    def __exit__(self, *error) -> None:
        self._context.__exit__(*error)

    def event(self) -> dict:
        fields = {}
        while line := next(self._lines):
            name, _, value = line.partition(": ")
            fields[name] = json.loads(value) if name == "data" else value
        return fields


def test_a_change_arrives(admin, tell):
    with Stream(admin, **{"Last-Event-ID": "0"}) as stream:
        assert stream.answer.headers["content-type"].startswith("text/event-stream")
        assert stream.answer.headers["cache-control"] == "no-store"
        (changed,) = tell("position", lat_deg=45.0, lon_deg=9.0)
        event = stream.event()
    assert event["event"] == "position"
    assert event["id"] == str(changed)
    assert event["data"]["lat_deg"] == 45.0
    assert event["data"]["device_id"] == "d" * 32
    assert event["data"]["vehicle_id"] is None
    assert event["data"]["at"].startswith("2026-03-01T12:00:00")


@pytest.mark.both_databases
def test_last_event_id_resumes_without_loss_or_repetition(admin, tell):
    ids = tell("one", "two", "three")
    with Stream(admin, **{"Last-Event-ID": str(ids[0])}) as stream:
        assert [stream.event()["event"] for _ in range(2)] == ["two", "three"]
        tell("four")
        assert stream.event()["event"] == "four"
    tell("five")
    with Stream(admin, **{"Last-Event-ID": str(ids[2])}) as stream:
        assert [stream.event()["event"] for _ in range(2)] == ["four", "five"]


def test_a_page_may_name_its_place_in_the_address(admin, tell):
    ids = tell("one", "two")
    with admin.stream("GET", "/api/v1/live", params={"after": ids[0]}) as answer:
        text = ""
        for chunk in answer.iter_text():
            text += chunk
            if "event: two" in text:
                break
    assert "event: one" not in text


def test_only_the_own_organisation(admin, tell, database, clock):
    with database.transaction() as session:
        other = Organisation(name="other", created_at=clock() + dt.timedelta(days=1))
        session.add(other)
    with Stream(admin, **{"Last-Event-ID": "0"}) as stream:
        tell("secret", organisation_id=other.id)
        tell("mine")
        assert stream.event()["event"] == "mine"


def test_strangers_and_nonsense_are_refused(client, admin):
    assert client.get("/api/v1/live").status_code == 401
    assert admin.get("/api/v1/live", headers={"Last-Event-ID": "x"}).status_code == 422


def test_pages_that_go_on_from_different_changes_are_one_look(admin, database, monkeypatch, clock):
    monkeypatch.setattr(routes, "LIFE_S", 0.0)
    for query in ("", "?after=744", "?after=745", "?after=745&afterwards=1", "?after=746"):
        assert admin.get(f"/api/v1/live{query}").status_code == 200
    clock.advance(minutes=2)
    admin.get("/api/v1/live?after=747")
    with database.reading() as session:
        looks = session.scalars(
            sa.select(AuditEntry).where(AuditEntry.action == "location.read").order_by(AuditEntry.id)
        )
        assert [(look.subject, look.detail) for look in looks] == [
            ("/api/v1/live", {}),
            ("/api/v1/live", {"query": "afterwards=1"}),
            ("/api/v1/live", {}),
        ]


def test_a_quiet_stream_is_kept_alive(admin, monkeypatch):
    monkeypatch.setattr(routes, "HEARTBEAT_S", 0.05)
    with admin.stream("GET", "/api/v1/live") as answer:
        seen = ""
        for chunk in answer.iter_text():
            seen += chunk
            if seen.count(": still here\n\n") >= 2:
                break


def test_a_stream_ends_after_its_life(admin, monkeypatch, tell):
    monkeypatch.setattr(routes, "LIFE_S", 0.0)
    tell("one")
    assert admin.get("/api/v1/live").text == "retry: 2000\n\n"


def test_closing_the_hub_ends_all_streams(admin, app, tell):
    heard, ended = threading.Event(), threading.Event()

    def listen():
        with Stream(admin, **{"Last-Event-ID": "0"}) as stream:
            stream.event()
            heard.set()
            with pytest.raises(StopIteration):
                stream.event()
            ended.set()

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    tell("one")
    assert heard.wait(10.0)
    app.state.live.close()
    thread.join(10.0)
    assert ended.is_set()
    assert admin.get("/api/v1/live").text == "retry: 2000\n\n"


def test_a_slow_listener_is_cut_off_and_loses_nothing(database, organisation, tell):
    async def scenario() -> tuple[list[str], list[str]]:
        hub = LiveHub(database, poll_s=0.001)
        slow = hub.changes(organisation.id, 0)
        first = asyncio.ensure_future(anext(slow))
        await asyncio.to_thread(tell, "first")
        seen = [(await first).kind]
        quick = hub.changes(organisation.id, None)
        coming = asyncio.ensure_future(anext(quick))
        for _ in range(QUEUE + 10):  # one at a time: the quick one is never behind, the slow one always
            await asyncio.to_thread(tell, "more")
            assert (await coming).kind == "more"
            coming = asyncio.ensure_future(anext(quick))
        seen += [change.kind async for change in slow]  # its queue has run over meanwhile
        again = hub.changes(organisation.id, 1)
        missed = [(await anext(again)).kind for _ in range(QUEUE + 10)]
        coming.cancel()
        await asyncio.wait([coming])
        for generator in (quick, again):
            await generator.aclose()
        return seen, missed

    seen, missed = asyncio.run(scenario())
    assert seen == ["first"]
    assert missed == ["more"] * (QUEUE + 10)


def test_what_another_process_told_is_not_told_again(database, organisation, tell):
    async def scenario() -> str:
        ids = tell("one", "two")
        hub = LiveHub(database, poll_s=0.001)
        early = hub.changes(organisation.id, 0)
        await anext(early)
        hub._cursor = ids[0] - 1  # as if this process had not seen them yet
        ahead = hub.changes(organisation.id, ids[1])
        coming = asyncio.ensure_future(anext(ahead))
        await asyncio.to_thread(tell, "three")
        kind = (await coming).kind
        for generator in (early, ahead):
            await generator.aclose()
        return kind

    assert asyncio.run(scenario()) == "three"


def test_the_table_is_left_alone_while_nobody_listens(database, organisation, tell, monkeypatch):
    asked = []
    real = LiveHub._news
    monkeypatch.setattr(LiveHub, "_news", lambda hub, after: asked.append(after) or real(hub, after))

    async def scenario() -> None:
        hub = LiveHub(database, poll_s=0.001)
        listener = hub.changes(organisation.id, 0)
        coming = asyncio.ensure_future(anext(listener))
        await asyncio.to_thread(tell, "one")
        await coming
        await listener.aclose()
        count = len(asked)
        await asyncio.to_thread(tell, "two")
        await asyncio.to_thread(tell, "three")
        assert len(asked) <= count + 1

    asyncio.run(scenario())


@pytest.mark.both_databases
def test_an_id_of_a_database_that_is_no_more_does_not_silence_the_stream(admin, tell):
    """A browser that was open while an older backup was restored."""
    over = threading.Event()

    def keep_telling() -> None:
        while not over.wait(0.1):
            tell("two")

    teller = threading.Thread(target=keep_telling)
    teller.start()
    try:
        with Stream(admin, **{"Last-Event-ID": "1000000"}) as stream:
            assert stream.event()["event"] == "two"
    finally:
        over.set()
        teller.join()
