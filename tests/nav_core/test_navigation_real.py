"""GPS/INS on a real road, against a pose from another source."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.mounting import estimate_mounting
from nav_core.navigation import Vehicle, hidden, inside, miss, navigate, radius
from tests import recordings

BEGIN, END = 46425.0, 46455.0


@pytest.mark.parametrize(("smoothed", "farthest"), [(True, 3.0), (False, 30.0)])
def test_half_a_minute_without_gps_at_town_speed(smoothed, farthest):
    """A RAV4 with its mounting estimated from the same minute; forward it only has 17 s of fixes behind it."""
    drive = recordings.comma2k19(with_gyro=True)
    mounting = estimate_mounting(drive)
    assert mounting.R_va is not None
    assert mounting.sigma is not None
    solution = navigate(
        replace(drive, gnss=hidden(drive.gnss, BEGIN, END)),
        mounting.R_va,
        vehicle=Vehicle(mount_sigma=float(mounting.sigma.max())),
        speed_lag=mounting.speed_lag or 0.0,
        course_lag=mounting.course_lag or 0.0,
        smoothed=smoothed,
    )
    t, lat, lon = recordings.comma2k19_place()
    dark = (t > BEGIN) & (t < END)
    found = miss(solution, t[dark], lat[dark], lon[dark])
    reach = radius(solution)[(solution.t > BEGIN) & (solution.t < END)].max()
    far, share = found.distance.max(), inside(found).mean()
    print(f"smoothed {smoothed}: farthest {far:.2f} m, said to be within {reach:.1f} m, inside {share:.2f}")
    assert far < farthest
    assert share > 0.9
    assert np.interp(0.5 * (BEGIN + END), drive.gnss.t, drive.gnss.speed) > 12.0
