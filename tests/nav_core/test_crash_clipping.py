"""Saturation found, and the impulse behind it, also of pulses that the simulator does not draw."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash.clipping import restore, saturated
from nav_core.crash.curve import beta, curve_through
from nav_core.crash.fuse import Change, fuse
from nav_core.simulate import random_rotation

G = 9.80665

SHAPES = {
    "haversine": lambda x: 1.0 - np.cos(2.0 * np.pi * x),
    "early": lambda x: x**0.8 * (1.0 - x) ** 2,
    "late": lambda x: x**2.2 * (1.0 - x) ** 0.9,
    "two peaks": lambda x: np.exp(-(((x - 0.3) / 0.13) ** 2)) + 0.8 * np.exp(-(((x - 0.65) / 0.14) ** 2)),
    "plateau": lambda x: np.clip(x / 0.15, 0.0, 1.0) * np.clip((1.0 - x) / 0.3, 0.0, 1.0),
}


def case(shape, rng):
    """Recorded and true horizontal impulse, m/s, estimate of it, and the spread of what was missing."""
    length, delta_v, full = rng.uniform(0.07, 0.16), rng.uniform(4.0, 16.0), rng.choice([8.0, 11.0, 16.0]) * G
    t = np.arange(-0.03, length + 0.05, 0.005) + rng.uniform(0.0, 0.005)
    fine = np.linspace(0.0, 1.0, 2001)
    s = delta_v * SHAPES[shape](np.clip(t / length, 0.0, 1.0)) / (length * np.trapezoid(SHAPES[shape](fine), fine))
    s = np.where((t > 0.0) & (t < length), s, 0.0)
    angle = rng.uniform(-np.pi, np.pi)
    u, A, g = np.array([np.cos(angle), np.sin(angle), 0.0]), random_rotation(rng).T, np.array([0.0, 0.0, -G])
    f = np.clip((s[:, None] * u + g) @ A.T + rng.normal(0.0, 0.8, (t.size, 3)), -full, full)
    found = saturated(f)
    a = f @ A - g
    if not found.flags.any():
        return None
    missing = restore(t, a, np.broadcast_to(A, (t.size, 3, 3)), found.flags)
    raw, estimate = np.trapezoid(a, t, axis=0), np.trapezoid(missing.a, t, axis=0)
    return delta_v, raw, estimate, missing.spread


@pytest.mark.parametrize("shape", SHAPES)
def test_missing_impulse_of_shapes_the_simulator_does_not_have(shape):
    rng = np.random.default_rng(7)
    errors, held, better = [], [], []
    for _ in range(40):
        one = case(shape, rng)
        if one is None:
            continue
        delta_v, raw, estimate, spread = one
        errors.append(abs(np.hypot(*estimate[:2]) / delta_v - 1.0))
        better.append(abs(np.hypot(*estimate[:2]) - delta_v) <= abs(np.hypot(*raw[:2]) - delta_v) + 0.05)
        change = Change(raw[:2], (estimate - raw)[:2], spread, 0.05**2 * np.eye(2))
        interval = fuse(change).resultant()
        held.append(interval.low <= delta_v <= interval.high)
    assert len(errors) > 12
    assert np.median(errors) < 0.03
    assert np.quantile(errors, 0.9) < 0.3  # flanks alone, no fixes
    assert np.mean(better) > 0.8
    assert np.mean(held) >= 0.7


def test_full_scale_is_told_by_a_sold_range_or_a_flat_top_and_not_by_a_smooth_peak():
    t = np.arange(60) / 200.0
    pulse = 20.0 * G * np.sin(np.pi * np.clip((t - 0.1) / 0.1, 0.0, 1.0))
    f = np.column_stack([pulse, 0.0 * t, np.full(t.size, -G)])
    assert not saturated(f).flags.any() or saturated(f).full_scale != pytest.approx(8.0 * G)
    clipped = saturated(np.clip(f, -8.0 * G, 8.0 * G))
    assert clipped.full_scale == pytest.approx(8.0 * G)
    assert clipped.flags[:, 0].sum() == np.count_nonzero(f[:, 0] >= 8.0 * G)
    odd = saturated(np.clip(f, -9.37 * G, 9.37 * G))
    assert odd.full_scale == pytest.approx(9.37 * G)
    smooth = saturated(1.017 * 0.35 * f)
    assert smooth.full_scale is None
    assert not saturated(np.zeros((0, 3))).flags.any()
    assert saturated(np.tile([0.0, 0.0, -G], (100, 1))).full_scale is None


@pytest.mark.parametrize("rate", [200.0, 1000.0, 2000.0, 5000.0, 10_000.0])
@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize("resolution", [0.0, 0.098])
def test_a_smooth_peak_is_no_rail_at_any_rate_and_a_rail_is_one(rate, noise, resolution):
    t = np.arange(round(0.4 * rate)) / rate
    rng = np.random.default_rng(2)
    for top, length in ((13.37, 0.1), (27.3, 0.15), (16.004, 0.12)):
        x = np.clip((t - 0.1) / length, 0.0, 1.0)
        for shape in (np.sin(np.pi * x), np.sin(np.pi * x) ** 2):
            pulse = top * G * shape + noise * rng.standard_normal(t.size)
            pulse = np.round(pulse / resolution) * resolution if resolution else pulse
            f = np.column_stack([pulse, 0.0 * t, np.full(t.size, -G)])
            if top != 16.004 or (rate > 500.0 and not resolution):  # a sample or two at a sold range may be either
                assert saturated(f).full_scale is None
            for share in (0.5, 0.9):
                rail = share * top * G
                found = saturated(np.clip(f, -rail, rail))
                assert found.full_scale == pytest.approx(rail, rel=1e-3)
                assert found.flags[:, 0].sum() >= np.count_nonzero(f[:, 0] >= rail)


def test_a_full_scale_known_from_elsewhere_counts_for_a_single_sample():
    f = np.tile([0.0, 0.0, -G], (50, 1))
    f[25, 0] = 9.37 * G
    assert saturated(f).full_scale is None
    assert saturated(f, known=9.37 * G).flags.sum() == 1


def test_an_axis_that_did_not_clip_tells_the_force():
    t = np.arange(0.0, 0.14, 0.005)
    s = 30.0 * G * np.sin(np.pi * np.clip((t - 0.02) / 0.1, 0.0, 1.0)) ** 2
    u = np.array([np.cos(0.35), np.sin(0.35), 0.0])
    f = np.clip(s[:, None] * u, -11.0 * G, 11.0 * G)
    flags = np.abs(f) >= 11.0 * G * 0.999
    assert flags[:, 0].any()
    assert not flags[:, 1].any()
    missing = restore(t, f, np.broadcast_to(np.eye(3), (t.size, 3, 3)), flags)
    assert np.trapezoid(missing.a[:, 0], t) == pytest.approx(np.trapezoid(s, t) * u[0], rel=0.03)
    assert missing.spread < 0.15


def test_a_curve_through_bounds_alone_stays_above_them_with_a_wide_spread():
    t = np.linspace(0.0, 0.12, 25)
    true = beta(t, np.array([0.0, np.log(0.12), np.log(400.0), np.log(1.5), np.log(1.5)]))
    s = np.where(true > 100.0, np.nan, true)
    curve = curve_through(t, s, np.ones(t.size), np.full(t.size, 100.0))
    hidden = np.isnan(s)
    assert (curve.expected[hidden] >= 100.0).all()
    assert curve.expected[~hidden] == pytest.approx(true[~hidden])
    weights = np.where(hidden, 0.005, 0.0)
    assert curve.sigma(weights) > 0.1 * float(weights @ curve.expected)


def test_ringing_does_not_pull_the_curve_to_the_dips():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 0.12, 1e-3)
    smooth = 200.0 * np.sin(np.pi * t / 0.12)
    rung = smooth + 60.0 * rng.standard_normal(t.size)
    full = 160.0
    clipped = rung >= full
    curve = curve_through(t, np.where(clipped, np.nan, rung), np.ones(t.size), np.full(t.size, full))
    truth, recorded = np.trapezoid(rung, t), np.trapezoid(np.minimum(rung, full), t)
    estimate = np.trapezoid(curve.expected, t)
    assert abs(estimate - truth) < 0.5 * (truth - recorded)
    assert curve.ringing > 20.0


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_both_rails_are_found_though_two_s_complement_is_not_the_same_on_both_sides(bits, sign):
    step = 16.0 * G / 2 ** (bits - 1)
    t = np.arange(0.0, 0.4, 0.005)
    blow = 24.0 * G * (np.sin(np.pi * t / 0.1) ** 2 * (t < 0.1) - np.sin(np.pi * t / 0.1) ** 2 * (t > 0.2) * (t < 0.3))
    counts = np.clip(np.round(sign * blow / step), -(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    f = np.column_stack([counts * step, 0.0 * t, np.full(t.size, -G)])
    flags = saturated(f).flags[:, 0]
    assert np.array_equal(flags, np.abs(blow) > 15.95 * G)
