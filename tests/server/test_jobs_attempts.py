"""When a box counts as one that kills workers, and when it does not; real kills are in tests/faults/test_deaths.py."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest
from fleet_world import Leg, World, cut, drive_of

from server.jobs import failures
from server.jobs.attempts import DEATHS, answered, begin, withdraw
from server.jobs.failures import Job
from server.jobs.run import run_job
from server.jobs.worker import RUNNING, Rounds, run_worker
from server.models import JobAttempt, JobFailure

pytestmark = pytest.mark.both_databases


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    return World(database, settings, clock, organisation)


@pytest.fixture
def job(world) -> Job:
    """A message that somebody had before."""
    return Job("message", world.device_id, "devices", {}, again=True)


def dies(world, clock, job: Job) -> bool:
    """Begin and give no answer; whether it could begin."""
    granted = begin(world.database, job, clock()).granted
    clock.advance(seconds=5.0)
    return granted


def test_a_job_without_a_sign_of_a_death_writes_nothing(world, clock, job):
    assert begin(world.database, replace(job, again=False), clock()) == begin(
        world.database, replace(job, again=False, alone=True), clock()
    )
    assert not world.rows(JobAttempt)


def test_deaths_in_a_row_make_a_dead_letter_that_can_be_replayed(world, clock, job):
    assert [dies(world, clock, job) for _ in range(DEATHS + 1)] == [True] * DEATHS + [False]
    row = world.one(JobFailure)
    assert (row.failures, row.dead_at is not None) == (DEATHS, True)
    assert row.error == f"WorkerDiedError: the worker died during the job, {DEATHS} times in a row"
    # Under any message, and also one that nobody had.
    assert not dies(world, clock, replace(job, id="other", again=False))
    with world.database.reading() as session:
        assert failures.left_alone(session, clock()) == {world.device_id: True}
    # An hour later once, and that counts too.
    clock.advance(seconds=failures.DEAD_AGAIN_S)
    assert [dies(world, clock, replace(job, id="hourly", again=again)) for again in (False, True)] == [True, False]
    assert world.one(JobFailure).failures == DEATHS + 1
    with world.database.transaction() as session:
        assert failures.forget(session, [world.device_id]) == [world.device_id]
    assert not world.rows(JobAttempt)
    assert dies(world, clock, job)


def test_any_answer_between_deaths_begins_the_count_anew(world, clock, job):
    def broken(_tally) -> None:
        raise RuntimeError("no luck")

    for _ in range(DEATHS):
        assert all(dies(world, clock, job) for _ in range(DEATHS - 1))
        run_job(world.database, job, lambda _tally: None, clock=clock)
        assert not world.rows(JobAttempt)
        assert not world.rows(JobFailure)
        assert all(dies(world, clock, job) for _ in range(DEATHS - 1))
        with pytest.raises(RuntimeError):
            run_job(world.database, job, broken, clock=clock)
        assert not world.rows(JobAttempt)
        answered(world.database, world.device_id)


def test_a_worker_that_is_told_to_stop_does_not_count(world, clock, job):
    def stops(_tally) -> None:
        raise SystemExit(0)

    assert dies(world, clock, job)
    for _ in range(2 * DEATHS):
        with pytest.raises(SystemExit):
            run_job(world.database, job, stops, clock=clock)
    assert world.one(JobAttempt).unanswered == 1
    withdraw(world.database, world.device_id)
    assert not world.rows(JobAttempt)


def test_workers_that_are_at_one_box_at_once_are_no_deaths(world, clock, job):
    for number in range(2 * DEATHS):
        assert dies(world, clock, replace(job, id=f"message {number}"))
    assert world.one(JobAttempt).unanswered == 1
    # What was never heard of again is a death after all.
    clock.advance(minutes=10.0)
    assert dies(world, clock, replace(job, id="later"))
    assert world.one(JobAttempt).unanswered == 2


def test_the_embedded_worker_is_wary_after_a_death_until_it_has_been_round(world, clock):
    batch = cut(drive_of(Leg(60, 10.0)))[0]
    world.put(batch, 0)
    told: list[Job] = []
    for wary in (True, False):
        rounds = Rounds(world.database, world.store, clock, wary=wary)
        rounds._bring_up_to_date = lambda *_, **__: told.append(world.rows(JobAttempt)) or failing()
        rounds.once(threading.Event())
        clock.advance(hours=1)
        with world.database.transaction() as session:
            failures.forget(session, [world.device_id])
        rounds.once(threading.Event())
        clock.advance(hours=1)
        with world.database.transaction() as session:
            failures.forget(session, [world.device_id])
    assert [len(rows) for rows in told] == [1, 0, 0, 0]


def failing():
    raise RuntimeError("stays due")


def test_only_a_worker_that_ends_in_order_takes_its_mark_away(settings, clock):
    running = settings.data_dir / RUNNING
    stop = threading.Event()
    thread = threading.Thread(target=run_worker, args=(settings,), kwargs={"stop": stop, "clock": clock})
    thread.start()
    while not running.exists():
        assert thread.is_alive()
        stop.wait(0.01)
    stop.set()
    thread.join(60.0)
    assert not thread.is_alive()
    assert not running.exists()
