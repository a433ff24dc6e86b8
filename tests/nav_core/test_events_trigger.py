"""Trigger, time zero and end of event against pulses whose integral is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.events.trigger import (
    KMH,
    THRESHOLD,
    TRIGGER,
    TRIGGER_WINDOW,
    WINDOW,
    _rest,
    groups,
    integrate,
    off_rest,
    rest_reference,
    sideways_within,
    stream_of,
    strongest_change,
    strongest_reference,
    window_around,
)
from nav_core.records import Inertial
from nav_core.signal import first_not_before

G = 9.80665


def half_sine(t, begin, length, delta_v):
    x = np.clip((t - begin) / length, 0.0, 1.0)
    return delta_v * np.pi / (2.0 * length) * np.sin(np.pi * x)


def recording(rate, *, delta_v=10.0, length=0.1, angle=0.4, noise=0.0, span=6.0):
    t = np.arange(round(span * rate)) / rate
    a = half_sine(t, 4.0, length, delta_v)
    f = np.column_stack([-a * np.cos(angle), -a * np.sin(angle), np.full(t.size, -G)])
    return Inertial(t, f + noise * np.random.default_rng(1).standard_normal(f.shape))


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 1000.0, 10_000.0])
def test_time_zero_is_the_start_of_the_first_window_over_the_threshold(rate):
    stream = stream_of(recording(rate), np.eye(3))
    core = int(np.searchsorted(stream.t, 4.05)) - 1
    window = window_around(stream.t, stream.v[:, :2], core)
    # v = dv/2 (1 - cos(pi t / T)): the first 20 ms window over 0.8 km/h ends where v gets there.
    reached = 0.1 / np.pi * np.arccos(1.0 - 2.0 * THRESHOLD / 10.0)
    assert stream.t[window.zero] - 4.0 == pytest.approx(reached - WINDOW, abs=1.1 / rate)
    left = 0.1 - reached + WINDOW
    assert stream.t[window.end] - 4.0 == pytest.approx(left, abs=2.5 / rate)
    assert stream.t[window.last] - stream.t[window.end] == pytest.approx(0.03, abs=1.1 / rate)
    change = np.hypot(*(stream.v[window.last, :2] - stream.v[window.zero, :2]))
    assert change == pytest.approx(10.0, rel=0.04 if rate < 100.0 else 0.01)  # trapezia of five samples


def test_eight_km_h_within_150_ms_trigger_and_less_does_not():
    for delta_v, length, triggers in ((8.2, 0.14, True), (7.8, 0.14, False), (16.0, 0.5, False), (9.0, 0.02, True)):
        stream = stream_of(recording(200.0, delta_v=delta_v * KMH, length=length), np.eye(3))
        assert bool(stream.strongest.max() >= TRIGGER) is triggers


@pytest.mark.parametrize("size", [0, 1, 2, 700])
def test_compiled_search_for_the_strongest_change_and_plain_code_agree(size):
    rng = np.random.default_rng(size)
    t = np.cumsum(rng.choice([0.0, 0.004, 0.0061, 0.3], size))  # repeats, jitter, gaps
    v = np.cumsum(rng.standard_normal((size, 3)), axis=0)
    windows = np.array([0.2, 0.4, 0.6, 0.8, 1.0]) * TRIGGER_WINDOW
    np.testing.assert_array_equal(strongest_change(t, v, 0.0), strongest_reference(t, v, windows))
    quiet = v * rng.choice([1e-3, 1.0], (size, 1), p=[0.99, 0.01])
    found, whole = strongest_change(t, quiet, 0.5), strongest_reference(t, quiet, windows)
    np.testing.assert_array_equal(found >= 0.5, whole >= 0.5)
    np.testing.assert_array_equal(found[found > 0.0], whole[found > 0.0])
    for ahead in (-2.0, 0.0, 0.15):
        np.testing.assert_array_equal(first_not_before(t, t + ahead), np.searchsorted(t, t + ahead))


@pytest.mark.parametrize("size", [1, 2, 3000])
@pytest.mark.parametrize("violent", [0.0, 0.002])
def test_compiled_rest_and_plain_code_agree(size, violent):
    rng = np.random.default_rng(size)
    t = np.cumsum(rng.choice([0.004, 0.0061, 4.0], size, p=[0.6, 0.399, 0.001]))  # jitter, gaps
    f = rng.standard_normal((size, 3)) - [0.0, 0.0, G]
    calm = np.ones(size, dtype=np.bool_)
    for k in np.flatnonzero(rng.random(size) < violent):
        calm[k : k + 400] = False
    np.testing.assert_array_equal(_rest(t, f, calm), rest_reference(t, f, calm))


def test_one_g_of_braking_does_not_trigger():
    t = np.arange(2000) / 200.0
    f = np.tile([0.0, 0.0, -G], (t.size, 1))
    f[t > 5.0, 0] = -G
    assert stream_of(Inertial(t, f), np.eye(3)).strongest.max() < 0.7 * TRIGGER


def test_a_pulse_that_swings_through_zero_is_one_event():
    t = np.arange(6000) / 1000.0
    a = half_sine(t, 4.0, 0.08, 8.0) + half_sine(t, 4.1, 0.05, 3.0)
    f = np.column_stack([-a, 0.0 * a, np.full(t.size, -G)])
    stream = stream_of(Inertial(t, f), np.eye(3))
    window = window_around(stream.t, stream.v[:, :2], 4040)
    assert stream.t[window.end] > 4.14


def test_nothing_is_integrated_over_a_gap():
    inertial = recording(200.0)
    keep = (inertial.t < 2.0) | (inertial.t > 3.0)
    stream = stream_of(Inertial(inertial.t[keep], inertial.f[keep]), np.eye(3))
    assert np.count_nonzero(stream.step == 0.0) == 2
    before, after = stream.at(np.array([3.95, 4.15]))
    assert np.hypot(*(after - before)[:2]) == pytest.approx(10.0, rel=0.01)


def test_slope_and_bias_are_taken_off_and_the_opening_of_a_short_burst_serves():
    t = np.arange(500) / 1000.0
    a = half_sine(t, 0.1, 0.1, 10.0)
    f = np.column_stack([-a + 0.8, 0.3 + 0.0 * a, np.full(t.size, -G)])
    stream = stream_of(Inertial(t, f), np.eye(3))
    after = stream.at(np.array([0.25]))[0]
    assert after[0] == pytest.approx(-10.0, abs=0.01)
    assert after[1] == pytest.approx(0.0, abs=1e-6)


def test_integrals_and_groups():
    t = np.linspace(0.0, 1.0, 11)
    step = np.diff(t, prepend=t[:1])
    assert integrate(np.column_stack([t]), step)[-1, 0] == pytest.approx(0.5)
    flags = np.array([0, 1, 1, 0, 0, 0, 1, 0, 1, 0, 0], dtype=bool)
    assert groups(flags, t, 0.25) == [(1, 2), (6, 8)]
    assert groups(np.zeros(11, dtype=bool), t, 0.25) == []
    assert stream_of(Inertial(np.zeros(0), np.zeros((0, 3))), np.eye(3)).t.size == 0


def test_walks_along_the_samples_are_what_array_code_says():
    stream = stream_of(recording(200.0, noise=0.5), np.eye(3))
    np.testing.assert_array_equal(off_rest(stream), np.linalg.norm(stream.f - stream.rest, axis=1))
    j = np.minimum(np.searchsorted(stream.t, stream.t + 0.1), stream.t.size - 1)
    np.testing.assert_array_equal(sideways_within(stream, 0.1), stream.v[j, 1] - stream.v[:, 1])
