"""A real crash, NHTSA v10146 (rigid barrier, 57.1 km/h), against its notes; real driving and handling without one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import firwin

from nav_core.crash import reconstruct_drive
from nav_core.mounting import estimate_mounting
from nav_core.records import Drive, Gnss, Inertial, MountingEstimate
from tests.recordings import comma2k19, corolla, folder, loose_phone

G, KMH = 9.80665, 3.6
NOTES = {"093": 66.1, "099": 67.4, "094": 66.9, "100": 66.7}
PEAKS = {"093": 45.4, "099": 47.4, "094": 39.6, "100": 40.6}
NO_GNSS = Gnss(*[np.zeros(0)] * 6, fix=np.zeros(0, dtype=bool))


def mounting(lag=None):
    covariance = np.radians(0.5) ** 2 * np.eye(3)
    return MountingEstimate(
        "ready", "whole-drive", R_va=np.eye(3), covariance=covariance, speed_lag=lag, course_lag=lag
    )


def channel(name):
    path = folder("nhtsa-v10146-camry-full-frontal") / f"v10146.{name}"
    t, a = np.loadtxt(path, unpack=True)
    return t, np.column_stack([G * a, 0.0 * a, np.full(t.size, -G)])


def slower(t, f):
    """The same at 200 Hz behind an anti-alias filter of 80 Hz."""
    taps = firwin(801, 80.0, fs=10_000.0)
    padded = np.pad(f[:, 0], 400, mode="edge")
    low = np.convolve(padded, taps, mode="valid")
    return t[::50], np.column_stack([low[::50], f[::50, 1], f[::50, 2]])


def receiver(lag=0.3):
    """4 fixes per second: 57.1 km/h before, 10 km/h backwards after, late by the lag."""
    t = np.arange(-10.0, 5.0, 0.25) + 0.07
    after = t - lag > 0.06
    travelled = np.cumsum(np.where(after, -10.0, 57.1) / KMH * 0.25)
    return Gnss(
        t=t,
        lat=0.8 + travelled / 6.37e6,
        lon=np.full(t.size, 0.1),
        alt=np.zeros(t.size),
        speed=np.where(after, 10.0, 57.1) / KMH,
        course=np.where(after, np.pi, 0.0),
        fix=np.ones(t.size, dtype=bool),
    )


@pytest.mark.parametrize("name", NOTES)
def test_the_four_channels_at_10_khz(name):
    t, f = channel(name)
    (event,) = reconstruct_drive(Drive(Inertial(t, f), NO_GNSS), mounting())
    assert event.kind == "crash"
    assert -KMH * event.delta_v.longitudinal.value == pytest.approx(NOTES[name], abs=0.7)
    assert 0.109 <= event.t0 + event.delta_v.time_of_max <= 0.117
    rebound = -KMH * event.delta_v.longitudinal.value - 57.09
    assert rebound == pytest.approx(NOTES[name] - 57.09, abs=1.0)
    assert event.pulse.filter == "CFC60"
    assert event.peak / G == pytest.approx(
        45.4 if name == "093" else {"099": 47.4, "094": 39.6, "100": 40.6}[name], abs=0.3
    )
    assert abs(np.degrees(event.pdof.value)) < 0.1
    assert event.indices.olc / G == pytest.approx(29.5, abs=1.5)


@pytest.mark.parametrize("name", NOTES)
def test_the_same_at_200_hz(name):
    t, f = slower(*channel(name))
    (event,) = reconstruct_drive(Drive(Inertial(t, f), NO_GNSS), mounting())
    assert -KMH * event.delta_v.longitudinal.value == pytest.approx(NOTES[name], rel=0.02)
    assert event.delta_v.resultant.low * KMH - 0.5 <= NOTES[name] <= event.delta_v.resultant.high * KMH + 0.5


@pytest.mark.parametrize("name", NOTES)
@pytest.mark.parametrize("full_scale", [16.0, 11.0])
@pytest.mark.parametrize("decimated", [False, True])
def test_clipped_with_fixes_before_and_after(name, full_scale, decimated):
    t, f = slower(*channel(name)) if decimated else channel(name)
    clipped = Inertial(t, np.clip(f, -full_scale * G, full_scale * G))
    (event,) = reconstruct_drive(Drive(clipped, receiver()), mounting(0.3))
    resultant = event.delta_v.resultant
    assert KMH * resultant.value == pytest.approx(66.7, rel=0.12)
    assert KMH * resultant.low <= 66.0
    assert KMH * resultant.high >= 67.4
    assert event.clipped_samples > 5
    assert KMH * event.impact_speed.value == pytest.approx(57.1, abs=0.5)


def test_clipped_without_any_fix_the_interval_is_wide_and_starts_at_what_was_measured():
    t, f = slower(*channel("093"))
    (event,) = reconstruct_drive(Drive(Inertial(t, np.clip(f, -16.0 * G, 16.0 * G)), NO_GNSS), mounting())
    resultant = event.delta_v.resultant
    assert resultant.low > 0.98 * event.delta_v.measured
    assert resultant.high - resultant.low > 0.2 * resultant.value
    assert event.indices.asi_2010 is None


@pytest.mark.parametrize("recording", [corolla, comma2k19, loose_phone])
def test_real_driving_and_handling_is_no_crash(recording):
    drive = recording()
    events = reconstruct_drive(drive, estimate_mounting(drive))
    assert [each.kind for each in events if each.severe] == []


@pytest.mark.parametrize("phase", [0, 25])
def test_sampled_at_200_hz_without_an_anti_alias_filter_it_says_so(phase):
    t, f = channel("093")
    (event,) = reconstruct_drive(Drive(Inertial(t[phase::50], f[phase::50]), NO_GNSS), mounting())
    assert "aliasing_likely" in {remark.code for remark in event.quality}
    # A quarter of delta-V is folded away; the interval must say so.
    assert KMH * event.delta_v.resultant.low <= NOTES["093"] <= KMH * event.delta_v.resultant.high


def test_a_recording_without_gravity_is_reconstructed_and_says_so():
    t, f = channel("094")
    (event,) = reconstruct_drive(Drive(Inertial(t, f * np.array([1.0, 0.0, 0.0])), NO_GNSS), mounting())
    assert event.kind == "crash"
    assert KMH * event.delta_v.resultant.value == pytest.approx(NOTES["094"], abs=0.7)
    assert "no_gravity" in {remark.code for remark in event.quality}
