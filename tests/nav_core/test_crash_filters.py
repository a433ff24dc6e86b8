"""CFC filters, severity indices and injury curves against closed forms and published figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import filtfilt

from nav_core.crash.filters import RateError, cfc, evenly, low_pass, moving_mean
from nav_core.crash.indices import asi_1998, asi_2010, head, olc
from nav_core.crash.injury import CURVES, MPH, probability, risks
from nav_core.events.record import Estimate

G = 9.80665


def gain(run, rate, frequency):
    t = np.arange(round(4.0 * rate)) / rate
    wave = np.sin(2.0 * np.pi * frequency * t)
    middle = slice(round(1.5 * rate), round(2.5 * rate))
    return np.sqrt(2.0) * np.std(run(wave)[middle])


@pytest.mark.parametrize(("channel_class", "corner"), [(60, 100.0), (180, 300.0), (600, 1000.0), (1000, 1650.0)])
def test_a_class_is_3_db_down_where_the_standard_says(channel_class, corner):
    down = gain(lambda x: cfc(x, 20_000.0, channel_class), 20_000.0, corner)
    assert 20.0 * np.log10(down) == pytest.approx(-3.0, abs=0.25)  # the standard's band is wider


def test_the_class_filter_is_the_recursion_of_the_standard():
    rate, x = 10_000.0, np.random.default_rng(0).standard_normal(4000)
    wa = np.tan(2.0 * np.pi * 60.0 * 2.0775 / rate / 2.0)
    D = 1.0 + np.sqrt(2.0) * wa + wa**2
    a0 = wa**2 / D
    b1, b2 = -2.0 * (wa**2 - 1.0) / D, (-1.0 + np.sqrt(2.0) * wa - wa**2) / D
    expected = filtfilt([a0, 2.0 * a0, a0], [1.0, -b1, -b2], x)
    middle = slice(1000, 3000)
    assert cfc(x, rate, 60)[middle] == pytest.approx(expected[middle], abs=1e-9)


@pytest.mark.parametrize(("channel_class", "rate"), [(60, 200.0), (60, 500.0), (180, 1000.0), (1000, 8000.0)])
def test_a_class_is_refused_below_its_rate(channel_class, rate):
    with pytest.raises(RateError, match=f"CFC {channel_class} needs"):
        cfc(np.zeros(1000), rate, channel_class)


def test_13_hz_is_13_hz_at_any_rate_and_refused_where_it_is_not():
    for rate in (100.0, 1000.0):
        assert gain(lambda x, rate=rate: low_pass(x, rate, 13.0), rate, 13.0) == pytest.approx(np.sqrt(0.5), abs=0.01)
    with pytest.raises(RateError):
        low_pass(np.zeros(100), 50.0, 13.0)


def test_asi_of_a_long_constant_acceleration_is_that_of_its_definition():
    a = np.tile(np.array([6.0, 3.0, 2.0]) * G, (3000, 1))
    expected = np.sqrt(0.5**2 + (1.0 / 3.0) ** 2 + 0.2**2)
    assert asi_2010(a, 1000.0) == pytest.approx(expected, rel=1e-6)
    assert asi_1998(a, 1000.0) == pytest.approx(expected, rel=1e-6)


def test_the_50_ms_mean_of_a_50_ms_block_is_the_block():
    t = np.arange(1000) / 1000.0
    x = np.where((t >= 0.4) & (t < 0.45), 1.0, 0.0)
    mean = moving_mean(x, 1000.0, 0.05)
    assert mean.max() == pytest.approx(1.0, abs=0.03)
    assert mean.sum() == pytest.approx(x.sum())
    assert moving_mean(np.ones((7, 2)), 100.0, 0.05) == pytest.approx(np.ones((7, 2)))


def test_olc_of_a_constant_deceleration():
    # lost = a t: 65 mm at t1 = sqrt(0.13 / a); 0.235 = (a t2 t1 + ...) solved by bisection here.
    a = 25.0 * G
    t = np.linspace(0.0, 0.3, 30_001)
    t1 = np.sqrt(2.0 * 0.065 / a)
    low, high = t1, 0.3
    for _ in range(80):
        t2 = 0.5 * (low + high)
        way = 0.5 * a * (t2**2 - t1**2) - 0.5 * a * t2 * (t2 - t1)
        low, high = (t2, high) if way < 0.235 else (low, t2)
    assert olc(t, a * t) == pytest.approx(a * t2 / (t2 - t1), rel=1e-4)
    assert olc(t, 0.1 * t) is None
    assert olc(t[:1000], a * t[:1000]) is None


def test_thiv_of_a_constant_deceleration_and_of_a_spin():
    t = np.linspace(0.0, 1.0, 2001)
    a = np.tile([-6.0, 0.0, 0.0], (t.size, 1))
    C = np.broadcast_to(np.eye(3), (t.size, 3, 3))
    thiv, phd = head(t, a, C, np.zeros((t.size, 3)))
    assert thiv == pytest.approx(np.sqrt(2.0 * 6.0 * 0.6), rel=5e-3)
    assert phd == pytest.approx(6.0, rel=1e-6)
    sideways = np.tile([0.0, 6.0, 0.0], (t.size, 1))
    assert head(t, sideways, C, np.zeros((t.size, 3)))[0] == pytest.approx(np.sqrt(2.0 * 6.0 * 0.3), rel=5e-3)
    # Too slow a sampling for the 10 ms mean; too weak a blow for the head to arrive.
    slow = t[::20]
    assert head(slow, a[::20], C[::20], np.zeros((slow.size, 3)))[1] is None
    assert head(t, 0.01 * a, C, np.zeros((t.size, 3))) == (None, None)


def test_even_samples():
    t = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    x, rate = evenly(t, np.column_stack([t, 2.0 * t]))
    assert rate == pytest.approx(10.0)
    assert x[:, 1] == pytest.approx(0.2 * np.arange(6))


@pytest.mark.parametrize(("name", "percent"), [("NHTSA-2022-all", 5.3), ("TUM-logistic", 7.3), ("GIDAS", 7.1)])
def test_curves_give_their_published_values_at_40_km_h(name, percent):
    curve = next(each for each in CURVES if each.name == name and each.level == "MAIS3+")
    assert 100.0 * probability(curve, 40.0 / 3.6) == pytest.approx(percent, abs=0.06)


def test_risk_carries_the_interval_and_holds_to_its_sector():
    delta_v = Estimate(40.0 / 3.6, 36.0 / 3.6, 44.0 / 3.6)
    names = {"": {each.curve for each in risks(delta_v, None)}}
    for label, pdof in (("front", 10.0), ("rear", 175.0), ("side", 90.0)):
        angle = np.radians(pdof)
        found = risks(delta_v, Estimate(angle, angle - 0.05, angle + 0.05))
        names[label] = {each.curve for each in found}
        p = found[0].probability
        assert p.low < p.value < p.high
        assert p.low == pytest.approx(1.0 / (1.0 + np.exp(6.954 - 0.1637 * delta_v.low / MPH)))
    assert "NHTSA-2022-frontal" in names["front"]
    assert "NHTSA-2022-rear" in names["rear"]
    assert names["side"] == names[""]
