"""Several blows of one event: none is lost, each has its own numbers, the strongest has the headline."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.crash import reconstruct_drive
from nav_core.crash.edr import element_table
from nav_core.records import Drive, Inertial
from nav_core.simulate import Impact
from tests.nav_core.test_crash_impact import NO_GNSS, T0, blows, codes, fixes, severe, told
from tests.nav_core.test_crash_reconstruct import mounted, struck


@pytest.mark.parametrize("apart", [0.4, 0.8, 2.0, 4.5])
@pytest.mark.parametrize("sizes", [(6.0, 11.0), (11.0, 6.0)])
def test_the_stronger_blow_has_the_headline_and_the_other_is_listed(apart, sizes):
    t, f = blows((T0, sizes[0], 0.3), (T0 + apart, sizes[1], -0.5))
    event = severe(Drive(Inertial(t, f), NO_GNSS), told())
    head = int(np.argmax(sizes))
    times, angles = (T0, T0 + apart), (0.3, -0.5)
    assert event.t0 == pytest.approx(times[head], abs=0.03)
    assert event.t_end == pytest.approx(times[head] + 0.1, abs=0.03)
    assert event.delta_v.resultant.value == pytest.approx(sizes[head], rel=0.02)
    assert event.pdof.value == pytest.approx(angles[head], abs=0.03)
    (other,) = event.second_impacts
    assert other.t0 == pytest.approx(times[1 - head], abs=0.03)
    assert other.resultant.low <= sizes[1 - head] <= other.resultant.high
    assert other.pdof.value == pytest.approx(angles[1 - head], abs=0.03)
    assert "multi_event" in codes(event)
    assert (event.begins, event.ends) == (min(event.t0, other.t0), max(event.t_end, other.t_end))
    elements = {each.name: each for each in element_table(event)}
    assert elements["Multi-event, number of events"].values == (2.0,)
    assert elements["Time from event 1 to 2"].values[0] == pytest.approx(apart, abs=0.03)


@pytest.mark.parametrize("sizes", [(1.5, 1.6), (1.7, 1.4), (4.0, 3.5), (1.5, 4.0)])
@pytest.mark.parametrize("apart", [0.4, 0.6, 0.8])
@pytest.mark.parametrize("with_gps", [True, False])
def test_a_blow_soon_after_another_at_standstill_is_not_lost(sizes, apart, with_gps):
    first, second = (Impact(t=30.0 + k * apart, delta_v=sizes[k], pdof=np.pi - 0.3 * k) for k in (0, 1))
    drive, truth = struck(first, second, route="static")
    (event,) = reconstruct_drive(drive if with_gps else Drive(drive.inertial, NO_GNSS), mounted(truth))
    assert event.kind == ("crash" if max(sizes) > 2.3 else "parked_impact")
    seen = sorted([event.t0, *(each.t0 for each in event.second_impacts)])
    assert seen == pytest.approx([30.0, 30.0 + apart], abs=0.03)


@pytest.mark.parametrize("clipped", [False, True])
def test_the_speed_before_the_second_blow_is_what_the_first_left(clipped):
    t, f = blows((T0, 6.0, 0.0), (T0 + 1.0, 9.0, 0.0))
    if clipped:
        f = np.clip(f, -11.0 * 9.80665, 11.0 * 9.80665)
    gnss = fixes(4.0, [0.0, T0, T0 + 0.1, T0 + 1.0, T0 + 1.1, 20.0], [18.0, 18.0, 12.0, 12.0, 3.0, 3.0])
    event = severe(Drive(Inertial(t, f), gnss), told())
    assert event.t0 == pytest.approx(T0 + 1.0, abs=0.03)
    assert event.impact_speed.low <= 12.0 <= event.impact_speed.high
    assert event.impact_speed.value == pytest.approx(12.0, abs=0.6)
    # What the driver did is what he did before the first.
    assert event.driver.t[-1] == pytest.approx(-1.0, abs=0.03)
    assert event.driver.speed[-2] == pytest.approx(18.0, abs=0.3)


def test_a_blow_is_not_held_against_the_one_that_follows_it():
    """The mean of the seconds before must not hold a blow: 25 m/s in it would pass for 11 m/s² of gravity."""
    t, f = blows((T0, 25.0, 0.0), (T0 + 1.2, 4.0, np.pi / 2.0))
    event = severe(Drive(Inertial(t, f), NO_GNSS), told())
    (other,) = event.second_impacts
    assert other.t0 == pytest.approx(T0 + 1.2, abs=0.03)
    assert other.t_end - other.t0 == pytest.approx(0.1, abs=0.03)
    assert other.resultant.value == pytest.approx(4.0, abs=0.15)
    assert other.pdof.value == pytest.approx(np.pi / 2.0, abs=0.05)
