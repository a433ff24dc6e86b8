"""Hard braking until the blow: what it was, how the box lies, gravity without fixes, clipped samples."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash import reconstruct_drive
from nav_core.events.level import gravity_before, usual_force
from nav_core.events.trigger import stream_of
from nav_core.records import Drive, Inertial, MountingEstimate
from nav_core.simulate import random_rotation
from tests.nav_core.test_crash_impact import NO_GNSS, T0, G, blows, codes, fixes, severe, told

UNKNOWN = MountingEstimate("insufficient", "whole-drive")


def braked(seconds, hard, *each, quiet=False, until=20.0):
    """Blows after braking that ends with the first of them; `quiet` as of a smooth road at a crawl."""
    t, f = blows(*(each or ((T0, 7.0, 0.2),)), until=until)
    if quiet:
        f = f + 0.75 * (np.where((t > T0 - 0.01) & (t < T0 + 0.12), 0.0, 1.0)[:, None] * (_smooth(f) - f))
    f[(t > T0 - seconds) & (t < T0), 0] -= hard
    return Inertial(t, f)


def _smooth(f):
    return np.column_stack([np.convolve(np.pad(x, 10, mode="edge"), np.ones(21) / 21.0, "valid") for x in f.T])


@pytest.mark.parametrize("seconds", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("with_gps", [True, False])
def test_a_box_is_not_said_to_have_turned_because_the_driver_braked(seconds, with_gps):
    start = 8.0 + 8.5 * seconds
    gnss = fixes(4.0, [0.0, T0 - seconds, T0, T0 + 0.1, 20.0], [start, start, 8.0, 1.2, 1.2])
    event = severe(Drive(braked(seconds, 8.5), gnss if with_gps else NO_GNSS), told())
    assert event.kind == "crash"
    assert "box_turned" not in codes(event)


def test_a_box_that_was_turned_by_a_braked_for_blow_is_said_to_be():
    inertial = braked(2.0, 8.5)
    f = inertial.f.copy()
    f[inertial.t > T0 + 0.1] @= np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    assert "box_turned" in codes(severe(Drive(Inertial(inertial.t, f), NO_GNSS), told()))


@pytest.mark.parametrize("seconds", [1.5, 3.0])
@pytest.mark.parametrize("delta_v", [1.9, 3.0, 6.0])
@pytest.mark.parametrize("mounting", [told(), UNKNOWN])
@pytest.mark.parametrize("burst", [False, True])
def test_a_vehicle_that_brakes_is_not_parked(seconds, delta_v, mounting, burst):
    inertial = braked(seconds, 8.5, (T0, delta_v, 0.2), quiet=True)
    if burst:
        keep = (inertial.t > T0 - 3.0) & (inertial.t < T0 + 4.0)
        inertial = Inertial(inertial.t[keep], inertial.f[keep])
    found = {each.kind for each in reconstruct_drive(Drive(inertial, NO_GNSS), mounting)}
    assert "parked_impact" not in found
    assert "handling" not in found
    assert ("crash" in found) is (delta_v > 2.3)


@pytest.mark.parametrize("seconds", [0.5, 2.5, 4.0])
@pytest.mark.parametrize("begin", [0.0, 5.5, 7.5, 9.0])
@pytest.mark.parametrize("mounting", [told(), UNKNOWN])
def test_braking_is_not_taken_for_a_slope_without_fixes(seconds, begin, mounting):
    """Whatever there is of it, or of what came before it, in the recording."""
    inertial = braked(seconds, 8.5)
    keep = inertial.t >= begin
    event = severe(Drive(Inertial(inertial.t[keep], inertial.f[keep]), NO_GNSS), mounting)
    resultant = event.delta_v.resultant
    assert resultant.low <= 7.0 <= resultant.high
    if mounting is not UNKNOWN:
        assert resultant.value == pytest.approx(7.0, abs=0.12)
        assert event.pdof.value == pytest.approx(0.2, abs=0.02)
    assert event.t_end == pytest.approx(T0 + 0.1, abs=0.03)


@pytest.mark.parametrize("full_scale", [8.0, 11.0])
def test_brakes_beside_a_clipped_blow_do_not_bend_its_direction(full_scale):
    """A blow across the brakes, a sensor axis along neither: the clipped axis is told by the others."""
    errors, held = [], []
    for seed in range(12):
        inertial = braked(2.0, 8.0, (T0, 10.0, -1.0))
        A = random_rotation(np.random.default_rng(seed)).T
        f = np.clip(inertial.f @ A.T, -full_scale * G, full_scale * G)
        mounting = MountingEstimate(
            "ready", "whole-drive", R_va=A.T, covariance=1e-4 * np.eye(3), speed_lag=0.2, course_lag=0.2
        )
        event = severe(Drive(Inertial(inertial.t, f), NO_GNSS), mounting)
        if not event.clipped_samples:
            continue
        resultant = event.delta_v.resultant
        errors.append(abs(resultant.value / 10.0 - 1.0))
        held.append(resultant.low <= 10.0 <= resultant.high)
    assert len(errors) >= 6
    assert np.median(errors) < 0.03
    assert np.mean(held) >= 0.85


def test_gravity_is_that_of_a_slope_and_of_a_bias_but_not_of_the_throttle():
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 30.0, 0.01)
    f = np.array([0.5, -0.2, -G]) + rng.normal(0.0, 0.3, (t.size, 3))
    gravity = gravity_before(stream_of(Inertial(t, f), np.eye(3)), 29.0, 0.01)
    assert np.abs(gravity.f[:2] - [0.5, -0.2]).max() < 2.0 * gravity.sigma
    assert gravity.f[0] > 0.2
    f[t > 12.0, 0] += 2.9
    stream = stream_of(Inertial(t, f), np.eye(3))
    assert abs(gravity_before(stream, 29.0, 0.01).f[0] - 0.5) < 2.0 * gravity.sigma
    # Of axes of which nothing is known, the sigma admits it.
    blind = gravity_before(stream, 29.0)
    assert blind.sigma > 0.9 * abs(blind.f[0] - 0.5) - 2.0
    assert usual_force(t, f) == pytest.approx([0.5, -0.2, -G], abs=0.05)
