"""A real crash, NHTSA v10146 (rigid barrier, 57.1 km/h), against its notes; real driving and handling without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import firwin
from scipy.spatial.transform import Rotation

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


def turning(angle, rate):
    """The blow from another side, with real ringing across and up, of a car that it turns: force, rate, velocity.

    The left and right channels' difference stands for the ringing across, channel 097 for that up and down.
    """
    (t, left), (_, right), (_, up) = (
        np.loadtxt(folder("nhtsa-v10146-camry-full-frontal") / f"v10146.{name}", unpack=True)
        for name in ("093", "100", "097")
    )
    along, across = 0.4 * G * (left + right), 0.2 * G * (left - right)
    c, s = np.cos(angle), np.sin(angle)
    f = np.column_stack([c * along - s * across, s * along + c * across, 0.8 * G * up - G])
    x = np.clip(t / 0.12, 0.0, 1.0)
    w = np.column_stack([0.0 * t, 0.0 * t, rate * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))])
    turned = np.cumsum(w[:, 2]) * 1e-4
    turned -= turned[500]
    c, s = np.cos(turned), np.sin(turned)
    v = np.cumsum(np.column_stack([c * f[:, 0] - s * f[:, 1], s * f[:, 0] + c * f[:, 1]]), axis=0) * 1e-4
    return t, f, w, v - v[500]


@pytest.mark.parametrize(("angle", "rate"), [(0.26, 2.0), (-0.5, -3.0), (1.57, 1.5), (2.9, 0.5)])
@pytest.mark.parametrize("full_scale", [1000.0, 16.0, 11.0])
def test_three_ringing_axes_of_a_box_that_sits_askew_at_10_khz(angle, rate, full_scale):
    t, f, w, v = turning(angle, rate)
    R_va = Rotation.from_euler("YZX", [20.0, -35.0, 110.0], degrees=True).as_matrix()
    told = replace(mounting(0.3), R_va=R_va)
    f_a = np.clip(f @ R_va, -full_scale * G, full_scale * G)
    true = v[500:][int(np.argmax(np.hypot(*v[500:].T)))]
    size, pdof = float(np.hypot(*true)), float(np.arctan2(-true[1], -true[0]))
    at = np.arange(-10.0, 5.0, 0.25) + 0.07
    velocity = np.column_stack([np.interp(at - 0.3, t, v[:, k]) for k in range(2)])
    velocity[:, 0] += 16.0
    way = 0.25 * np.cumsum(velocity, axis=0) / 6.37e6
    zero, fix = np.zeros(at.size), np.ones(at.size, dtype=bool)
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    gnss = Gnss(at, 0.8 + way[:, 0], 0.1 + way[:, 1] / np.cos(0.8), zero, np.hypot(*velocity.T), course, fix=fix)
    for fixes in (gnss, NO_GNSS):
        (event,) = reconstruct_drive(Drive(Inertial(t, f_a, w @ R_va), fixes), told)
        assert event.kind == "crash"
        resultant = event.delta_v.resultant
        assert resultant.low <= size <= resultant.high
        assert event.pdof.low <= event.pdof.value + np.angle(np.exp(1j * (pdof - event.pdof.value))) <= event.pdof.high
        assert "gps_disagrees" not in {remark.code for remark in event.quality}
        if full_scale > 100.0:
            assert resultant.value == pytest.approx(size, rel=0.01)
            assert KMH * (resultant.high - resultant.low) < 2.0
        elif fixes is gnss:
            assert resultant.value == pytest.approx(size, rel=0.12)


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
