"""Digests, the clocks of boots, and the axis on which boots follow one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fleet_world import Leg, drive_of
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core.records import Gnss
from nav_core.signal import decimate
from server.formats.drive import join_gnss
from server.jobs.clock import from_arrival, from_fixes
from server.jobs.digest import decode, digest_drive, encode
from server.jobs.stretch import PAUSE_S, Piece, assemble, in_windows
from server.models import Boot


def check_same(one, other) -> None:
    for name in type(one).__dataclass_fields__:
        mine, others = getattr(one, name), getattr(other, name)
        assert (mine is None) == (others is None)
        if mine is not None:
            np.testing.assert_array_equal(mine, others, strict=True)


def piece(drive, boot="a", sequence=0) -> Piece:
    t = drive.inertial.t
    return Piece(boot, sequence, float(t[0]), float(t[-1]), f"{boot}{sequence}".rjust(64, "0"), digest_drive(drive))


def clock(boot="a", ordinal=0, offset=1e9, drift=0.0, first=0.0, last=1e4) -> Boot:
    return Boot(boot=boot, ordinal=ordinal, utc_offset_s=offset, utc_drift=drift, t_first_s=first, t_last_s=last)


@pytest.mark.parametrize("utc", [None, 1e9])
@pytest.mark.parametrize("start", [0.0, 12_345.678])
def test_a_digest_survives_storage_to_the_last_bit(utc, start):
    digest = digest_drive(drive_of(Leg(7, 3.0), start=start, utc=utc))
    stored = encode(digest)
    again = decode(stored)
    check_same(digest.ticks, again.ticks)
    check_same(digest.gnss, again.gnss)
    assert (digest.health, digest.remarks) == (again.health, again.remarks)
    assert len(stored) < 0.5 * (digest.ticks.index.size * 48 + digest.gnss.t.size * 60) + 1000


def test_a_digest_of_another_format_is_refused(monkeypatch):
    monkeypatch.setattr("server.jobs.digest.FORMAT", 2)
    stored = encode(digest_drive(drive_of(Leg(3, 3.0))))
    monkeypatch.undo()
    with pytest.raises(ValueError, match="format 2"):
        decode(stored)


def test_figures_of_health():
    drive = drive_of(Leg(20, 0.0), Leg(30, 5.0))
    t = drive.inertial.t
    keep = (t < 10.0) | (t >= 12.0)
    holed = replace(drive, inertial=replace(drive.inertial, t=t[keep], f=drive.inertial.f[keep]))
    health = digest_drive(holed).health
    assert health["rate_hz"] == pytest.approx(20.0)
    assert health["jitter_s"] == pytest.approx(0.0, abs=1e-9)
    assert (health["gaps"], health["gap_s"]) == (1, pytest.approx(2.0, abs=0.06))
    assert health["moving_s"] == pytest.approx(30.0, abs=0.6)
    assert health["fix_share"] == 1.0


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(4)))
def test_fixes_are_joined_in_time_whatever_their_order(order):
    gnss = drive_of(Leg(40, 5.0)).gnss
    names = ("t", "lat", "lon", "alt", "speed", "course", "fix")

    def part(k: int, utc: bool) -> Gnss:
        rows = slice(20 * k, 20 * k + 22)  # each repeats the beginning of the next
        return Gnss(*(getattr(gnss, name)[rows] for name in names), utc=gnss.utc[rows] if utc else None)

    joined = join_gnss([part(k, utc=k != 2) for k in order])
    assert np.array_equal(joined.t, gnss.t)
    assert np.array_equal(joined.lat, gnss.lat)
    assert np.isnan(joined.utc[50])
    assert join_gnss([]).t.size == 0


def test_a_clock_from_fixes_finds_offset_and_drift_among_liars():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 7200.0, 60.0)
    offset = 1e9 + 3e-5 * t + rng.normal(0.0, 0.02, t.size)
    offset[::10] += 1000.0
    found = from_fixes(t, offset)
    assert found.source == "gnss"
    assert found.offset_s == pytest.approx(1e9, abs=0.05)
    assert found.drift == pytest.approx(3e-5, abs=5e-6)
    assert 0.3 <= found.sigma_s < 0.5
    shuffled = rng.permutation(t.size)
    assert from_fixes(t[shuffled], offset[shuffled]) == found
    assert abs(from_fixes(t[:2], offset[:2]).drift) < 1e-3
    lies = from_fixes(t, 1e9 + 5.0 * t)
    assert (lies.drift, lies.sigma_s) == (0.0, 30.0)


def test_a_clock_from_arrival_says_how_little_it_knows():
    assert from_arrival(5.0).sigma_s == 30.0


def test_one_boot_keeps_its_own_time():
    drive = drive_of(Leg(30, 5.0), start=100.0)
    stretch = assemble([piece(drive)], {"a": clock()})
    whole = decimate(drive.inertial)
    assert np.array_equal(stretch.ticks.index, whole.index)
    assert np.array_equal(stretch.gnss.t, drive.gnss.t)
    assert stretch.unix_s(110.0) == pytest.approx(1e9 + 110.0)


def test_boots_follow_one_another_with_a_bounded_pause():
    boots = {
        "a": clock("a", 0, offset=1e9, last=30.0),
        "b": clock("b", 1, offset=1e9 + 200.0, last=30.0),
        "c": clock("c", 2, offset=1e9 + 90_000.0, last=30.0),
    }
    pieces = [piece(drive_of(Leg(30, 5.0), start=0.05, seed=k), name) for k, name in enumerate("abc")]
    stretch = assemble(pieces, boots)
    shifts = [segment.shift_s for segment in stretch.segments]
    assert shifts[0] == 0.0
    assert shifts[1] == pytest.approx(200.0, abs=0.2)
    assert shifts[2] == pytest.approx(shifts[1] + 30.0 + PAUSE_S[1], abs=0.5)
    assert np.all(np.diff(stretch.gnss.t) > 0.0)
    assert np.all(np.diff(stretch.ticks.index) > 0)
    for name, shift in zip("abc", shifts, strict=True):
        assert stretch.unix_s(shift + 10.0) == pytest.approx(boots[name].unix_s(10.0))
    assert stretch.unix_s(shifts[1] - 20.0) == pytest.approx(boots["b"].unix_s(0.0), abs=0.2)
    assert stretch.end_unix_s == pytest.approx(boots["c"].unix_s(30.0), abs=0.3)
    assert stretch.unix_s(1e9) == stretch.end_unix_s


def test_a_box_that_sleeps_for_weeks_within_a_boot_takes_no_weeks_on_the_axis():
    weeks = 2_000_000.0
    pieces = [piece(drive_of(Leg(30, 5.0), start=k * weeks), "a", k) for k in range(3)]
    stretch = assemble(pieces, {"a": clock()})
    assert stretch.ticks.t[-1] == pytest.approx(90.0 + 2.0 * PAUSE_S[1], abs=1.0)
    assert [segment.t_first_s for segment in stretch.segments] == pytest.approx([0.0, weeks, 2 * weeks], abs=0.2)
    second = stretch.segments[1].shift_s
    assert stretch.unix_s(weeks + 10.0 + second) == pytest.approx(1e9 + weeks + 10.0)
    part = stretch.between(1e9 + weeks + 10.0, 1e9 + 2 * weeks + 10.0)
    assert part.gnss.t.size == 61
    assert part.gnss.t[0] == pytest.approx(weeks + 10.0 + second)


def test_a_part_of_a_stretch():
    stretch = assemble([piece(drive_of(Leg(60, 5.0)))], {"a": clock()})
    part = stretch.between(1e9 + 20.0, 1e9 + 40.0)
    assert part.ticks.t.min() >= 20.0
    assert part.ticks.t.max() <= 40.0
    assert (part.gnss.t.min(), part.gnss.t.max()) == (20.0, 40.0)
    assert stretch.between(2e9, 3e9).ticks.index.size == 0


def test_pieces_fill_window_after_window_in_order():
    boots = {"a": clock("a", 0), "b": clock("b", 1, offset=2e9)}
    long = drive_of(Leg(30, 5.0))
    pieces = [piece(long, boot, k) for boot in "ab" for k in range(3)]
    windows = list(in_windows(pieces[::-1], boots, window_s=100.0))
    named = [([(p.boot, p.sequence) for p in kept], more) for kept, more in windows]
    assert named == [([("a", 0), ("a", 1), ("a", 2)], True), ([("b", 0), ("b", 1), ("b", 2)], False)]
