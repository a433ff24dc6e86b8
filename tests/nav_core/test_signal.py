"""Decimation to ticks that add up."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_core.errors import RangeError, ShapeError
from nav_core.records import Inertial
from nav_core.signal import TICK_RATE, Ticks, accumulate_reference, attenuation, decimate, merge


def _noise(t: np.ndarray, seed: int = 3) -> Inertial:
    return Inertial(t=t, f=np.random.default_rng(seed).normal(size=(t.size, 3)) - np.array([0.0, 0.0, 9.8]))


def _same(one: Ticks, other: Ticks) -> None:
    assert one.rate == other.rate
    np.testing.assert_array_equal(one.index, other.index)
    for name in ("weight", "moment", "square"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("step", [0.005, 0.0596, 0.1])
def test_compiled_and_reference_agree(step: float):
    rng = np.random.default_rng(8)
    t = 12.3 + np.arange(400) * step + rng.uniform(0.0, 0.4 * step, 400)
    _same(decimate(_noise(t)), accumulate_reference(t, _noise(t).f, TICK_RATE))


def test_a_constant_comes_through_unchanged():
    t = np.arange(0.0, 10.0, 0.005)
    ticks = decimate(Inertial(t=t, f=np.tile([1.0, -2.0, 9.0], (t.size, 1))))
    np.testing.assert_allclose(ticks.f, np.tile([1.0, -2.0, 9.0], (ticks.index.size, 1)), rtol=1e-12)
    np.testing.assert_allclose(ticks.scatter, 0.0, atol=1e-5)


def test_no_delay():
    t = np.arange(0.0, 20.0, 0.005)
    ticks = decimate(Inertial(t=t, f=np.stack([t, t, t], axis=1)))
    inner = ticks.valid & (ticks.t > 0.5) & (ticks.t < 19.5)
    np.testing.assert_allclose(ticks.f[inner, 0], ticks.t[inner], atol=1e-9)


@pytest.mark.parametrize("frequency", [0.3, 1.0, 2.5, 5.0, 9.0, 10.0, 12.5, 17.0, 20.0, 24.0])
def test_attenuation_is_what_it_says(frequency: float):
    t = np.arange(0.0, 60.0, 0.005)
    wave = np.exp(2j * np.pi * frequency * t)
    ticks = [decimate(Inertial(t=t, f=np.outer(part, np.ones(3)))) for part in (wave.real, wave.imag)]
    inner = (ticks[0].t > 1.0) & (ticks[0].t < 59.0)
    left = np.abs(ticks[0].f[inner, 0] + 1j * ticks[1].f[inner, 0])
    np.testing.assert_allclose(left, np.abs(attenuation(np.array(frequency))), atol=2e-4)


def test_vibration_bands_are_stopped():
    assert np.abs(attenuation(np.linspace(8.0, 25.0, 500))).max() < 0.009
    assert attenuation(np.array(1.0)) > 0.9
    assert attenuation(np.array(2.5)) == pytest.approx(0.5)
    np.testing.assert_allclose(attenuation(np.array([10.0, 20.0, 30.0])), 0.0, atol=1e-12)


def test_scatter_is_the_vibration_level():
    t = np.arange(0.0, 30.0, 0.005)
    f = np.zeros((t.size, 3))
    f[:, 2] = -9.8 + 0.7 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 14.0 * t)
    assert np.median(decimate(Inertial(t=t, f=f)).scatter) == pytest.approx(0.7, rel=0.02)


@settings(max_examples=30, deadline=None)
@given(
    cuts=st.lists(st.integers(1, 899), max_size=6, unique=True),
    order=st.randoms(use_true_random=False),
    step=st.sampled_from([0.005, 0.02, 0.06]),
)
def test_batches_add_up_to_the_stream_in_any_order(cuts: list[int], order: object, step: float):
    t = 77.7 + np.arange(900) * step
    stream = _noise(t)
    edges = [0, *sorted(cuts), t.size]
    parts = [decimate(Inertial(t=t[a:b], f=stream.f[a:b])) for a, b in pairwise(edges)]
    order.shuffle(parts)  # type: ignore[attr-defined]
    whole = decimate(stream)
    _same(merge(parts), whole)
    middle = len(parts) // 2
    if middle:
        _same(merge([merge(parts[:middle]), merge(parts[middle:])]), whole)


def test_gaps_are_not_bridged():
    t = np.concatenate([np.arange(0.0, 5.0, 0.005), np.arange(9.0, 12.0, 0.005)])
    ticks = decimate(_noise(t))
    inside = ticks.t[ticks.valid]
    assert not np.any((inside > 5.1) & (inside < 8.9))
    assert np.count_nonzero(ticks.valid) >= 78


def test_a_night_of_silence_costs_nothing():
    t = np.concatenate([np.arange(0.0, 2.0, 0.01), 1e6 + np.arange(0.0, 2.0, 0.01)])
    ticks = decimate(_noise(t))
    assert ticks.index.size < 60
    assert ticks.t[-1] > 1e6


@pytest.mark.parametrize("rate", [9.4, 10.0, 16.8])
def test_slow_phones_with_jitter_fill_their_ticks(rate: float):
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.5, 1.5, 600) / rate)
    ticks = decimate(_noise(t))
    assert np.mean(ticks.valid) > 0.9


def test_ticks_survive_storage():
    ticks = decimate(_noise(np.arange(0.0, 3.0, 0.01)))
    _same(Ticks.from_arrays(ticks.to_arrays()), ticks)


def test_nothing_gives_nothing():
    empty = decimate(Inertial(t=np.zeros(0), f=np.zeros((0, 3))))
    assert empty.index.size == 0
    assert empty.valid.size == 0


def test_refusals():
    ticks = decimate(_noise(np.arange(0.0, 1.0, 0.01)))
    with pytest.raises(RangeError):
        decimate(_noise(np.arange(3.0)), rate=0.0)
    with pytest.raises(RangeError):
        merge([ticks, decimate(_noise(np.arange(0.0, 1.0, 0.01)), rate=5.0)])
    with pytest.raises(ShapeError):
        merge([])
    with pytest.raises(ShapeError):
        Ticks(10.0, ticks.index, ticks.weight[:-1], ticks.moment, ticks.square)
