"""One blow made by formula: what the seconds before it, the mounting and missing samples do to its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash import reconstruct_drive
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate

G = 9.80665
NO_GNSS = Gnss(*[np.zeros(0)] * 6, fix=np.zeros(0, dtype=bool))
T0 = 10.0


def told(sigma_deg=(0.5, 0.5, 0.5), status="ready"):
    covariance = np.diag(np.radians(np.array(sigma_deg)) ** 2)
    return MountingEstimate(status, "whole-drive", R_va=np.eye(3), covariance=covariance, speed_lag=0.2, course_lag=0.2)


def blows(*each, rate=200.0, until=20.0, seed=1):
    """Haversine blows of (t, delta-V m/s, PDOF rad) over 0.1 s, with noise."""
    t = np.arange(0.0, until, 1.0 / rate)
    f = np.random.default_rng(seed).normal(0.0, 0.2, (t.size, 3)) - [0.0, 0.0, G]
    for begin, delta_v, pdof in each:
        u = (t - begin) / 0.1
        a = np.where((u > 0.0) & (u < 1.0), np.sin(np.pi * u) ** 2, 0.0) * 2.0 * delta_v / 0.1
        f[:, :2] -= a[:, None] * [np.cos(pdof), np.sin(pdof)]
    return t, f


def fixes(rate, times, speeds, *, lag=0.2, seed=2):
    """Fixes straight north; speeds by linear interpolation."""
    t = np.arange(0.03, times[-1], 1.0 / rate)
    v = np.interp(t - lag, times, speeds)
    lat = np.radians(45.0) + np.cumsum(v) / rate / 6.37e6
    v = np.maximum(v + np.random.default_rng(seed).normal(0.0, 0.05, t.size), 0.0)
    same = np.zeros(t.size)
    return Gnss(t, lat, same + 0.12, same, v, same, fix=np.ones(t.size, dtype=bool))


def codes(event):
    return {remark.code for remark in event.quality}


def severe(drive, mounting):
    return next(each for each in reconstruct_drive(drive, mounting) if each.severe)


@pytest.mark.parametrize("rate", [1.0, 4.0, 10.0])
@pytest.mark.parametrize("seconds", [0.5, 1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("lag", [0.15, 0.2, 0.25])
def test_braking_before_the_blow_leaves_the_impact_speed_alone(rate, seconds, lag):
    t, f = blows((T0, 7.0, 0.0))
    f[(t > T0 - seconds) & (t < T0), 0] -= 8.5
    start = 12.0 + 8.5 * seconds
    gnss = fixes(rate, [0.0, T0 - seconds, T0, T0 + 0.1, 20.0], [start, start, 12.0, 5.0, 5.0], lag=lag)
    event = severe(Drive(Inertial(t, f), gnss), told())
    assert event.impact_speed.low <= 12.0 <= event.impact_speed.high
    assert event.impact_speed.value == pytest.approx(12.0, abs=0.7)
    assert event.impact_speed.high - event.impact_speed.low < 3.2
    assert event.delta_v.resultant.low <= 7.0 <= event.delta_v.resultant.high
    assert event.delta_v.resultant.value == pytest.approx(7.0, rel=0.01)
    assert "gps_disagrees" not in codes(event)


@pytest.mark.parametrize("mounting", [MountingEstimate("insufficient", "whole-drive"), told((1.0, 1.0, 18.0)), told()])
@pytest.mark.parametrize("delta_v", [4.0, 11.0, 22.0])
def test_a_heading_that_is_not_known_leaves_the_resultant_as_sure_as_it_is(mounting, delta_v):
    event = severe(Drive(Inertial(*blows((T0, delta_v, 0.4))), NO_GNSS), mounting)
    resultant = event.delta_v.resultant
    assert resultant.low <= delta_v <= resultant.high
    assert resultant.high - resultant.low < 0.1 + 0.03 * delta_v
    if event.pdof is not None:
        sigma = np.degrees((event.pdof.high - event.pdof.low) / 3.92)
        assert sigma == pytest.approx(np.degrees(mounting.sigma[2]), abs=1.0)


@pytest.mark.parametrize("gap", [0.012, 0.02, 0.04, 0.06, 0.09])
@pytest.mark.parametrize("middle", [0.03, 0.05, 0.07])
def test_samples_missing_within_a_blow_are_said_and_widen_the_interval(gap, middle):
    t, f = blows((T0, 11.0, 0.0))
    keep = np.abs(t - T0 - middle) > 0.5 * gap
    found = [each for each in reconstruct_drive(Drive(Inertial(t[keep], f[keep]), NO_GNSS), told()) if each.severe]
    if gap > 0.06 and not found:
        return  # nothing left to see
    (event,) = found
    assert "gap_in_event" in codes(event)
    if gap <= 0.06:
        assert event.delta_v.resultant.low <= 11.0 <= event.delta_v.resultant.high
    assert event.indices.asi_2010 is None
    assert "indices_incomplete" in codes(event)


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5, 0.65])
@pytest.mark.parametrize("side", ["starts", "ends"])
def test_a_recording_that_starts_or_ends_in_a_blow_does_not_claim_to_hold_it_all(side, share):
    t, f = blows((T0, 14.0, 0.3))
    keep = t >= T0 + 0.1 * share if side == "starts" else t <= T0 + 0.1 * (1.0 - share)
    event = severe(Drive(Inertial(t[keep], f[keep]), NO_GNSS), told())
    assert f"{side}_in_event" in codes(event)
    resultant = event.delta_v.resultant
    assert resultant.low <= 14.0 <= resultant.high
    assert resultant.value < 14.0
    assert event.indices.asi_2010 is None


@pytest.mark.parametrize(
    ("silent", "remarked", "used"), [(0.0, False, True), (0.012, True, True), (0.05, True, False), (0.4, True, False)]
)
@pytest.mark.parametrize("every", [1, 2])
def test_a_gyro_that_is_silent_in_the_blow_is_said_and_not_made_up(silent, remarked, used, every):
    t, f = blows((T0, 11.0, 0.0), rate=400.0)
    w = np.zeros((t.size, 3))
    w[t > T0] = [0.0, 0.0, 1.0]
    w[np.abs(t - T0 - 0.05) < 0.5 * silent] = np.nan
    w[np.arange(t.size) % every != 0] = np.nan
    event = severe(Drive(Inertial(t, f, w), NO_GNSS), told())
    assert ("gyro_gap" in codes(event)) is remarked
    assert ("axes_rotating" in codes(event)) is not used
    assert event.basis.gyro is used


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("with_gps", [True, False])
def test_gravity_that_contradicts_the_mounting_leaves_only_resultants(sign, with_gps):
    """A box that measures with the other sign would have the blow come from the other side, to a degree."""
    t, f = blows((T0, 9.0, 0.4))
    gnss = fixes(4.0, [0.0, T0, T0 + 0.1, 20.0], [20.0, 20.0, 11.5, 11.5]) if with_gps else NO_GNSS
    event = severe(Drive(Inertial(t, sign * f), gnss), told())
    assert event.delta_v.resultant.low <= 9.0 <= event.delta_v.resultant.high
    assert ("mounting_disagrees" in codes(event)) is (sign < 0.0)
    assert (event.pdof is None) is (sign < 0.0)
    assert (event.delta_v.longitudinal is None) is (sign < 0.0)


def test_a_gyro_that_is_late_by_some_milliseconds_is_in_the_interval_of_pdof():
    errors, widths = [], []
    for late in (-0.004, -0.002, 0.0, 0.002, 0.004):
        t = np.arange(0.0, 20.0, 0.005)
        u = np.clip((t - T0) / 0.1, 0.0, 1.0)
        rate = 3.0 * u**2
        turn = np.cumsum(rate) * 0.005
        # The force comes from 0.4 rad of where the vehicle pointed at first; its axes turn away from it.
        a = np.where((u > 0.0) & (u < 1.0), np.sin(np.pi * u) ** 2, 0.0) * 2.0 * 9.0 / 0.1
        f = np.column_stack([-a * np.cos(0.4 - turn), -a * np.sin(0.4 - turn), np.full(t.size, -G)])
        w = np.column_stack([0.0 * t, 0.0 * t, np.interp(t - late, t, rate)])
        pdof = severe(Drive(Inertial(t, f, w), NO_GNSS), told((0.1, 0.1, 0.1))).pdof
        errors.append(abs(pdof.value - 0.4))
        widths.append(0.25 * (pdof.high - pdof.low))
    assert np.degrees(max(errors)) > 0.15
    assert all(error < 2.0 * width for error, width in zip(errors, widths, strict=True))
    assert np.degrees(max(widths)) < 0.6


def test_the_vehicle_is_not_at_rest_before_the_last_blow():
    t, f = blows((T0, 9.0, 0.0), (T0 + 3.0, 6.0, np.pi), until=30.0)
    speeds = [9.0, 9.0, 0.0, 0.0, 6.0, 0.0, 0.0]
    slowing = (t > T0 + 3.1) & (t < T0 + 7.1)
    f[slowing, 0] -= 1.5
    gnss = fixes(4.0, [0.0, T0, T0 + 0.1, T0 + 3.0, T0 + 3.1, T0 + 7.1, 30.0], speeds)
    event = severe(Drive(Inertial(t, f), gnss), told())
    assert len(event.second_impacts) == 1
    assert event.rest.t == pytest.approx(T0 + 7.1, abs=0.7)
    assert event.rest.distance > 8.0
