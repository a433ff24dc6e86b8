"""The whole-drive estimator on real recordings with known or knowable mountings."""

from __future__ import annotations

import numpy as np

from nav_core.mounting import estimate_mounting
from nav_core.mounting.whole_drive import estimate
from nav_core.records import Gnss
from nav_core.rotation import error_between
from nav_core.signal import decimate
from tests.recordings import comma2k19, comma2k19_travel_direction, corolla, loose_phone


def test_corolla_with_a_phone_fixed_forward_left_up():
    found = estimate_mounting(corolla())
    assert found.status == "ready"
    assert found.R_va is not None
    assert found.sigma is not None
    error = np.degrees(error_between(found.R_va, np.diag([1.0, -1.0, -1.0])))
    assert np.abs(error).max() < 3.0
    assert np.all(np.abs(error) < 3.0 * np.degrees(found.sigma))
    # An independent fit of the same drive: roll -2.1, pitch 1.8, yaw -1 to -2, forward-left-up.
    assert np.abs(error - [-2.1, -1.8, 1.5]).max() < 1.5
    assert found.changes == ()
    assert 0.3 < (found.speed_lag or 0.0) < 0.7


def test_halves_of_the_corolla_drive_agree():
    drive = corolla()
    ticks, middle = decimate(drive.inertial), float(np.median(drive.gnss.t))
    halves = []
    for part in (drive.gnss.t < middle, drive.gnss.t >= middle):
        columns = (getattr(drive.gnss, name)[part] for name in ("t", "lat", "lon", "alt", "speed", "course", "fix"))
        halves.append(estimate(ticks, Gnss(*columns)))
    one, other = halves
    assert one.R_va is not None
    assert other.R_va is not None
    assert one.sigma is not None
    assert other.sigma is not None
    apart = np.abs(error_between(one.R_va, other.R_va))
    assert np.all(apart < 1.96 * np.hypot(one.sigma, other.sigma))


def test_a_nearly_straight_minute_admits_what_it_cannot_know():
    found = estimate_mounting(comma2k19())
    assert found.status == "settling"
    assert found.R_va is not None
    assert found.sigma is not None
    travel = found.R_va @ comma2k19_travel_direction()
    pitch, yaw = np.arctan2(travel[2], travel[0]), np.arctan2(travel[1], travel[0])
    assert np.abs(np.degrees(pitch)) < 1.5
    assert np.abs(pitch) < 3.0 * found.sigma[1]
    assert np.degrees(found.sigma[2]) > 1.5
    assert np.abs(yaw) < 2.0 * found.sigma[2]
    assert "no_turns" in {reason.code for reason in found.reasons}


def test_a_handled_phone_has_no_mounting():
    found = estimate_mounting(loose_phone())
    assert found.status in ("not_fixed", "insufficient")
    assert found.R_va is None
    assert found.reasons
