"""The element table: complete, in order, and "not recorded" where a box cannot know."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash import reconstruct_drive
from nav_core.crash.edr import element_table
from nav_core.records import MountingEstimate
from nav_core.simulate import Impact, Scenario, simulate


@pytest.fixture(scope="module")
def tables():
    impact = Impact(t=40.0, delta_v=8.0, pdof=0.4, speed=18.0)
    drive, truth = simulate(Scenario(duration=70.0, impacts=(impact,), accel_full_scale=500.0), seed=3)
    known = MountingEstimate(
        "ready",
        "whole-drive",
        R_va=truth.R_va,
        covariance=1e-4 * np.eye(3),
        speed_lag=truth.speed_lag,
        course_lag=truth.course_lag,
    )
    told = next(each for each in reconstruct_drive(drive, known) if each.severe)
    untold = next(
        each for each in reconstruct_drive(drive, MountingEstimate("insufficient", "whole-drive")) if each.severe
    )
    return {element.name: element for element in element_table(told)}, element_table(untold)


def test_what_a_box_cannot_know_is_not_recorded(tables):
    told, _ = tables
    for name in (
        "Safety belt status, driver",
        "Service brake, on/off",
        "Engine rpm",
        "Frontal air bag deployment, time to deploy, driver",
        "Steering input",
        "Ignition cycle, crash",
    ):
        assert not told[name].recorded
        assert told[name].note.startswith("not recorded")


def test_delta_v_history_runs_at_100_hz_to_30_ms_after_the_end(tables):
    told, _ = tables
    history = told["Delta-V, longitudinal"]
    assert np.diff(history.times) == pytest.approx(0.01)
    assert history.values[0] == 0.0
    assert history.times[-1] <= 0.25
    largest = told["Maximum delta-V, longitudinal"]
    assert largest.values[0] == pytest.approx(-3.6 * 8.0 * np.cos(0.4), abs=0.6)
    assert largest.interval[0] <= largest.values[0] <= largest.interval[1]
    assert min(history.values) == pytest.approx(largest.values[0], abs=0.6)
    assert told["Maximum delta-V, lateral"].values[0] == pytest.approx(-3.6 * 8.0 * np.sin(0.4), abs=0.6)
    assert 60.0 < told["Time, maximum delta-V, resultant"].values[0] < 180.0


def test_speed_for_20_s_at_10_hz(tables):
    told, _ = tables
    speed = told["Speed, vehicle indicated"]
    assert len(speed.values) == 201
    assert speed.times[0] == pytest.approx(-20.0)
    assert speed.times[-1] == 0.0
    assert speed.values[-1] == pytest.approx(3.6 * 18.0, abs=1.5)


def test_both_tables_are_whole_whatever_is_known(tables):
    told, untold = tables
    assert [element.name for element in untold] == list(told)
    assert {element.table for element in untold} == {"I", "II"}
    by_name = {element.name: element for element in untold}
    assert not by_name["Delta-V, longitudinal"].recorded
    assert by_name["Maximum delta-V, resultant"].recorded
    assert by_name["Complete file recorded"].values == ("yes",)
    assert by_name["Multi-event, number of events"].values == (1.0,)
