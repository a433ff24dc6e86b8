"""Time base: order, gaps, jitter, stale fixes, the clock against UTC, lags."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_core.errors import ShapeError, TooLittleDataError
from nav_core.records import Gnss
from nav_core.timebase import fit_clock, fit_pulses, gaps, in_order, jitter, lag_between, stale


def test_rows_in_order_raise_no_remark():
    ordered = in_order(np.array([0.0, 0.5, 1.0]))
    assert ordered.keep.tolist() == [0, 1, 2]
    assert ordered.remarks == ()


def test_late_rows_are_sorted_and_the_first_of_equals_is_kept():
    ordered = in_order(np.array([0.0, 2.0, 1.0, 2.0, 3.0]))
    assert ordered.keep.tolist() == [0, 2, 1, 4]
    assert [remark.code for remark in ordered.remarks] == ["rows_out_of_order", "rows_repeated"]
    assert "1 of 5" in ordered.remarks[0].detail
    assert "1 of 5" in ordered.remarks[1].detail


def test_no_rows():
    assert in_order(np.zeros(0)).keep.size == 0


@given(st.lists(st.integers(0, 30), max_size=40))
def test_order_is_strict_complete_and_stable(stamps: list[int]):
    t = np.array(stamps, dtype=np.float64)
    keep = in_order(t).keep
    assert np.all(np.diff(t[keep]) > 0.0)
    assert set(t[keep]) == set(t)
    assert all(index == stamps.index(stamps[index]) for index in keep)


def test_gaps_are_told_from_the_usual_step():
    t = np.concatenate([np.arange(0.0, 1.0, 0.1), np.arange(3.0, 4.0, 0.1)])
    (gap,) = gaps(t)
    assert gap.begin == pytest.approx(0.9)
    assert gap.end == pytest.approx(3.0)
    assert gaps(t, longest=5.0) == ()
    assert gaps(t[:1]) == ()


def test_jitter_figures():
    rng = np.random.default_rng(4)
    t = np.arange(2000) * 0.01 + rng.normal(0.0, 5e-4, 2000)
    found = jitter(t)
    assert found.rate == pytest.approx(100.0, rel=0.01)
    assert found.spread == pytest.approx(5e-4 * np.sqrt(2.0), rel=0.1)
    assert found.shortest < 0.01 < found.longest
    with pytest.raises(TooLittleDataError):
        jitter(np.zeros(1))


def _gnss(speed: list[float], lat: list[float], utc: list[float] | None = None) -> Gnss:
    n = len(speed)
    values = np.array(lat)
    return Gnss(
        t=np.arange(n, dtype=np.float64),
        lat=values,
        lon=values,
        alt=np.zeros(n),
        speed=np.array(speed),
        course=np.full(n, np.nan),
        fix=np.ones(n, dtype=np.bool_),
        utc=None if utc is None else np.array(utc),
    )


def test_a_moving_fix_that_changes_nothing_is_stale():
    assert stale(_gnss([9.0, 9.0, 9.0], [0.1, 0.1, 0.2])).tolist() == [False, True, False]


def test_a_parked_vehicle_may_repeat_itself():
    assert not stale(_gnss([0.0, 0.0], [0.1, 0.1])).any()


def test_the_receivers_own_time_decides_where_it_is_known():
    assert stale(_gnss([9.0, 9.1, 9.2], [0.1, 0.2, 0.3], [5.0, 5.0, 6.0])).tolist() == [False, True, False]
    assert not stale(_gnss([9.0, 9.0], [0.1, 0.1], [5.0, 6.0])).any()
    assert not stale(_gnss([9.0], [0.1])).any()


def test_clock_recovers_offset_and_drift_through_outliers():
    rng = np.random.default_rng(7)
    t = np.sort(rng.uniform(100.0, 3700.0, 900))
    utc = 1.75e9 + (1.0 + 4e-5) * (t - 100.0) + rng.normal(0.0, 0.02, t.size)
    utc[rng.choice(t.size, 60, replace=False)] -= rng.uniform(1.0, 30.0, 60)
    clock = fit_clock(t, utc)
    assert clock.drift == pytest.approx(4e-5, abs=5.0 * clock.drift_sigma)
    assert clock.drift_sigma < 2e-6
    assert clock.scatter == pytest.approx(0.02, rel=0.3)
    middle = np.array([1900.0])
    assert clock.utc(middle)[0] == pytest.approx(1.75e9 + (1.0 + 4e-5) * 1800.0, abs=6.0 * clock.sigma)


def test_clock_sigma_is_true():
    rng = np.random.default_rng(11)
    scores = []
    for _ in range(200):
        t = np.arange(0.0, 300.0)
        clock = fit_clock(t, 1e9 + t + rng.normal(0.0, 0.05, t.size))
        scores.append((clock.utc_ref - 1e9 - clock.t_ref) / clock.sigma)
    assert 0.85 < np.std(scores) < 1.15


def test_a_single_dated_fix_gives_an_offset_and_no_drift():
    clock = fit_clock(np.array([5.0, 6.0]), np.array([np.nan, 1006.0]))
    assert clock.utc(np.array([7.0]))[0] == pytest.approx(1007.0)
    assert clock.drift == pytest.approx(0.0, abs=1e-9)
    assert clock.drift_sigma == pytest.approx(5e-4, rel=0.01)


def test_clock_refuses_what_has_no_meaning():
    with pytest.raises(TooLittleDataError):
        fit_clock(np.array([1.0]), np.array([np.nan]))
    with pytest.raises(ShapeError):
        fit_clock(np.zeros(2), np.zeros(3))


@pytest.mark.parametrize("lag", [0.0, 0.13, 0.6, 1.37])
def test_lag_of_a_series_behind_its_reference(lag: float):
    t = np.arange(0.0, 120.0, 0.1)

    def wave(at: np.ndarray) -> np.ndarray:
        return np.sin(0.3 * at) + 0.5 * np.sin(1.1 * at + 1.0)

    rng = np.random.default_rng(2)
    fixes = np.arange(3.0, 118.0, 1.0)
    late = 2.0 + 3.0 * wave(fixes - lag) + rng.normal(0.0, 0.02, fixes.size)
    found, residual = lag_between(fixes, late, t, wave(t), np.arange(-0.2, 2.01, 0.1))
    assert found == pytest.approx(lag, abs=0.02)
    assert 0.0 <= residual.min() < 1e-3


def test_lag_needs_something_to_compare():
    t = np.arange(10.0)
    lags = np.arange(3.0)
    with pytest.raises(TooLittleDataError):
        lag_between(t, t, t, t, lags[:2])
    with pytest.raises(TooLittleDataError):
        lag_between(t[:2], t[:2], t, t, lags)
    with pytest.raises(TooLittleDataError):
        lag_between(t + 100.0, t, t, t, lags)


def test_pulses_date_the_box_clock_and_tell_the_lag_of_the_fixes():
    rng = np.random.default_rng(4)
    start, drift, lag = 1_750_000_000.37, 4e-5, 0.23
    fixes = np.arange(1.0, 600.0, 0.25)
    utc = start + (1.0 + drift) * (fixes - lag)
    coarse = fit_clock(fixes + rng.uniform(0.0, 0.03, fixes.size), utc)
    seconds = np.arange(1_750_000_002.0, 1_750_000_590.0)
    pulses = (seconds - start) / (1.0 + drift) + 2e-6 * rng.standard_normal(seconds.size)
    pulses = pulses[rng.random(pulses.size) > 0.2]
    clock = fit_pulses(pulses, coarse)
    assert clock.utc(np.array([300.0]))[0] == pytest.approx(start + (1.0 + drift) * 300.0, abs=5e-6)
    assert clock.drift == pytest.approx(drift, abs=1e-7)
    assert clock.utc(np.array([300.0]))[0] - coarse.utc(np.array([300.0]))[0] == pytest.approx(lag + 0.015, abs=0.01)
    late = fit_clock(fixes + 1.3, utc)
    assert fit_pulses(pulses, late, lag=1.5).utc_ref == pytest.approx(clock.utc_ref, abs=1e-6)
    with pytest.raises(TooLittleDataError):
        fit_pulses(pulses + 0.5 + lag, coarse)
