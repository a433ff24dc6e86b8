"""Older data as evidence: chapters closed, joined, reopened by late data, and worth as much as the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fleet_world import World, cut

from nav_core.mounting.fusion import TripEvidence, solved
from nav_core.mounting.model import UNKNOWNS, Noise
from nav_core.mounting.trips import told_of
from nav_core.rotation import angle_between
from nav_core.simulate import Scenario, random_rotation, simulate
from server.jobs import chapters
from server.jobs.chapters import APART, Chapter
from server.models import Installation, Vehicle

R_VA = random_rotation(np.random.default_rng(5))
LONG = Scenario(route="gentle", duration=1900.0, R_va=R_VA, accel_rate=20.0, gnss_rate=1.0, accel_bias=0.0, crown=0.01)


@pytest.fixture
def world(database, settings, clock, organisation) -> World:
    world = World(database, settings, clock, organisation)
    world.estimator = told_of
    return world


def _evidence(number: int) -> TripEvidence:
    rng = np.random.default_rng(number)
    root = rng.normal(size=(40, 1 + UNKNOWNS))
    return TripEvidence(np.eye(3), 0.2, 0.3, root.T @ root, 1800.0)


def _chapters(count: int) -> list[Chapter]:
    return [Chapter(1e4 * k, 1e4 * (k + 1), 1800.0, _evidence(k), f"{k:064x}") for k in range(count)]


def test_chapters_survive_the_row_to_the_last_bit():
    kept = _chapters(4)
    back = chapters.read(chapters.written(kept, "a/1"), "a/1")
    for one, other in zip(kept, back, strict=True):
        assert (one.since_s, one.until_s, one.input_sha256) == (other.since_s, other.until_s, other.input_sha256)
        np.testing.assert_array_equal(one.evidence.gram, other.evidence.gram)
    assert chapters.read(chapters.written(kept, "a/1"), "a/2") == []


def test_old_chapters_are_joined_and_nothing_is_lost():
    many = _chapters(APART + 5)
    back = chapters.read(chapters.written(many, "a/1"), "a/1")
    assert len(back) == APART + 1
    assert back[0].evidence.trips == 5
    assert (back[0].since_s, back[0].until_s, back[0].length_s) == (0.0, 5e4, 9000.0)
    one, other = chapters.past(many), chapters.past(back)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(solved(one, Noise())[1], solved(other, Noise())[1], rtol=1e-9)


def test_late_data_reopen_the_newest_chapters_as_far_as_they_can_be_read_again():
    back = chapters.read(chapters.written(_chapters(APART + 5), "a/1"), "a/1")
    assert chapters.reopened(back, back[-1].until_s) == back
    assert chapters.reopened(back, back[-2].until_s) == back[:-1]
    assert chapters.reopened(back, back[1].since_s) == back[:1]
    assert chapters.reopened(back, back[0].until_s - 1.0) == back  # several trips in one: too late
    assert chapters.reopened(back, -100.0) == back
    long = [replace(chapter, length_s=3600.0) for chapter in back]
    assert chapters.reopened(long, long[-2].since_s) == long  # more than fits an estimate
    assert chapters.reopened(long, long[-1].since_s) == long[:-1]


def test_a_silent_chapter_takes_nothing_away():
    told = _chapters(2)
    silent = replace(told[1], evidence=None)
    back = chapters.read(chapters.written([told[0], silent], "a/1"), "a/1")
    assert back[1].evidence is None
    past = chapters.past(back)
    assert past is not None
    np.testing.assert_array_equal(past.gram, told[0].evidence.gram)
    assert chapters.past([silent]) is None


def _drive(world: World, clock, seed: int, boot: str) -> None:
    drive, _ = simulate(replace(LONG, start_utc=LONG.start_utc + 4000.0 * seed), seed=seed)
    for k, batch in enumerate(cut(drive, seconds=300.0)):
        world.put(batch, k, boot=boot)
        clock.advance(seconds=300.0)
        world.bring_up()
    world.settle()


def test_a_long_trip_becomes_a_chapter_and_the_next_one_costs_its_own_length(world, clock):
    read: list[float] = []

    def counted(ticks, gnss, past, noise):
        read.append(float(ticks.t[-1] - ticks.t[0]))
        return told_of(ticks, gnss, past, noise)

    world.estimator = counted
    _drive(world, clock, 1, "one")
    first = dict(world.one(Installation).result)
    read.clear()
    _drive(world, clock, 2, "two")
    assert max(read) < 2000.0
    row = world.one(Installation)
    assert row.status == "ready"
    assert row.result["sigma_deg"]["z"] < 0.85 * first["sigma_deg"]["z"]
    assert np.degrees(angle_between(np.array(row.result["R_va"]), R_VA)) < 2.0
    with world.database.reading() as session:
        kept = chapters.read(session.get_one(Installation, row.id).evidence, row.algorithm)
    assert len(kept) == 2
    assert kept[0].until_s <= kept[1].since_s + 1.0


def test_the_vehicles_side_of_the_road_reaches_the_estimator(world, clock, organisation):
    sides = []

    def seen(ticks, gnss, past, noise):
        sides.append(noise.crown_mean)
        return told_of(ticks, gnss, past, noise)

    world.estimator = seen
    with world.database.transaction() as session:
        vehicle = Vehicle(organisation_id=organisation.id, name="left-hander", created_at=clock(), traffic_side="left")
        session.add(vehicle)
        session.flush()
        vehicle_id = vehicle.id
    world.device_id = world.new_device(vehicle_id)
    drive, _ = simulate(Scenario(duration=60.0, accel_rate=20.0), seed=1)
    for k, batch in enumerate(cut(drive, seconds=30.0)):
        world.put(batch, k)
    world.bring_up()
    assert sides
    assert sides[0] < 0.0


def test_a_backlog_is_taken_in_whole_window_by_window(world):
    spans: list[float] = []

    def counted(ticks, gnss, past, noise):
        spans.append(ticks.index.size / ticks.rate)
        return told_of(ticks, gnss, past, noise)

    world.estimator = counted
    drive, _ = simulate(replace(LONG, duration=9600.0, accel_rate=10.0), seed=4)
    for k, batch in enumerate(cut(drive, seconds=300.0)):
        world.put(batch, k)
    assert world.bring_up().batches == 32
    assert sum(spans) == pytest.approx(9600.0, abs=5.0)
    row = world.one(Installation)
    with world.database.reading() as session:
        kept = chapters.read(session.get_one(Installation, row.id).evidence, row.algorithm)
    assert sum(chapter.length_s for chapter in kept) == pytest.approx(9600.0, abs=5.0)


def test_what_follows_a_move_after_long_pauses_is_all_there():
    """Six boots eight hours apart: the part from the sixth on has the sixth's data, and no other."""
    from server.jobs.digest import digest_drive
    from server.jobs.stretch import Piece, assemble
    from server.models import Boot

    boots, pieces = {}, []
    for k in range(6):
        drive, _ = simulate(replace(LONG, duration=300.0), seed=k)
        boots[f"b{k}"] = Boot(
            boot=f"b{k}", ordinal=k, utc_offset_s=28_800.0 * k, utc_drift=0.0, t_first_s=0.0, t_last_s=300.0
        )
        pieces.append(Piece(f"b{k}", 0, 0.0, 300.0, f"{k:064x}", digest_drive(drive)))
    stretch = assemble(pieces, boots)
    part = stretch.between(28_800.0 * 5 + 10.0, np.inf)
    assert part.length_s == pytest.approx(290.0, abs=0.5)
    assert part.gnss.t.size == pytest.approx(290, abs=2)
    before = stretch.between(-np.inf, 28_800.0 * 3 - 100.0)
    assert before.length_s == pytest.approx(900.0, abs=2.0)
    assert before.end_unix_s == pytest.approx(28_800.0 * 2 + 300.0, abs=1.0)


def test_a_contradiction_fades_the_past_once_and_not_with_every_look(world, clock):
    _drive(world, clock, 1, "one")
    world.estimator = lambda ticks, gnss, past, noise: told_of(ticks, gnss, past, noise)._replace(past_share=0.3)

    def weight() -> float:
        row = world.one(Installation)
        with world.database.reading() as session:
            first = chapters.read(session.get_one(Installation, row.id).evidence, row.algorithm)[0]
        assert first.evidence is not None
        return float(np.trace(first.evidence.gram))

    before = weight()
    drive, _ = simulate(replace(LONG, duration=600.0, start_utc=LONG.start_utc + 8000.0), seed=2)
    for k, batch in enumerate(cut(drive, seconds=150.0)):
        world.put(batch, k, boot="two")
        clock.advance(seconds=150.0)
        world.bring_up()
    assert weight() == before  # looked at four times, still open
