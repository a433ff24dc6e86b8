"""Trips of one installation, fused: sharper than each, true to its sigma, and deaf to a moved box no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nav_core.errors import ShapeError
from nav_core.mounting.again import BIAS_AGAIN, TURN_AGAIN
from nav_core.mounting.fixes import usable_fixes
from nav_core.mounting.fusion import TripEvidence, disagreement, joined, solved, trip_evidence
from nav_core.mounting.model import MILLI_G, Noise
from nav_core.mounting.moved import RESTLESS, STRANGER
from nav_core.mounting.refine import Fit
from nav_core.mounting.solution import solve
from nav_core.mounting.stretch import prepare
from nav_core.records import Inertial
from nav_core.rotation import error_between
from nav_core.signal import decimate
from nav_core.simulate import Scenario, random_rotation, simulate
from nav_core.simulate.days import DECIMATED, day
from nav_core.typing import Floats

ROUTES = ("urban", "gentle", "straight", "highway", "urban")


def _fit(scenario: Scenario, bias: Floats, seed: int) -> Fit:
    drive, _ = simulate(replace(scenario, accel_bias=0.0), seed=seed)
    inertial = Inertial(drive.inertial.t, drive.inertial.f + bias)
    return solve(prepare(decimate(inertial), usable_fixes(drive.gnss)), Noise()).fit


def _installation(number: int) -> tuple[Floats, float, list[Fit]]:
    """A box, a car and a country: what stays is drawn once, what changes is drawn for every trip."""
    rng = np.random.default_rng((31, number))
    R_va, bias = random_rotation(rng), rng.normal(0.0, 5.0 * MILLI_G, 3)
    crown = float(np.radians(rng.uniform(0.3, 1.2)))
    lags = rng.uniform(0.0, 0.6, 2)
    fits = []
    for index, route in enumerate(ROUTES):
        scenario = Scenario(
            route=route,
            duration=150.0,
            R_va=R_va,
            accel_rate=50.0,
            crown=crown + rng.normal(0.0, TURN_AGAIN[0]),
            speed_lag=float(lags[0]),
            course_lag=float(lags[1]),
        )
        again = rng.normal(0.0, BIAS_AGAIN, 3)
        fits.append(_fit(scenario, bias + again, seed=40_000 + 10 * number + index))
    return R_va, crown, fits


@pytest.fixture(scope="module")
def installations() -> list[tuple[Floats, float, list[Fit]]]:
    return [_installation(number) for number in range(10)]


def test_fused_trips_are_sharper_and_mean_their_sigma(installations):
    single, fused, normal = [], [], []
    for R_va, crown, fits in installations:
        found, covariance = solved(joined([trip_evidence(fit) for fit in fits]), Noise())
        error = error_between(found, R_va) - [crown, 0.0, 0.0]
        fused.append(error)
        normal.append(error @ np.linalg.solve(covariance, error))
        single += [error_between(fit.R_va, R_va) - [crown, 0.0, 0.0] for fit in fits]
    rms_single, rms_fused = (np.degrees(np.sqrt(np.mean(np.square(e), axis=0))) for e in (single, fused))
    assert np.all(rms_fused < 0.75 * rms_single)
    assert rms_fused[2] < 0.35
    # Three degrees of freedom each: the mean of ten lies under 4.8 at 99 %; the simulated car is never loaded.
    assert 0.5 < np.mean(normal) < 4.8


def test_several_trips_in_one_fit_mean_their_sigma():
    """Read as one drive, what each trip has of its own passes for yaw.  No roll: nobody knows the bank of the roads."""
    normal, single = [], []
    for seed in range(24):
        trips = [
            replace(
                DECIMATED,
                route=route,
                duration=duration,
                accel_bias=30.0 * MILLI_G,
                accel_bias_drift=10.0 * MILLI_G,
            )
            for route, duration in (("highway", 600.0), ("urban", 60.0), ("straight", 300.0))
        ]
        made = day(trips, seed=3000 + seed)
        noise = Noise(bias=STRANGER, drift=RESTLESS)
        fit = solve(prepare(decimate(made.drive.inertial), usable_fixes(made.drive.gnss)), noise).fit
        assert len(fit.trips()) == 3
        found, covariance = solved(trip_evidence(fit), noise)
        error, alone = (error_between(R_va, made.mountings[0][1])[1:] for R_va in (found, fit.R_va))
        normal.append(error @ np.linalg.solve(covariance[1:, 1:], error))
        single.append(abs(alone[1]) - abs(error[1]))
    # Two degrees of freedom each: the mean of 24 lies between 1.1 and 3.2 at 99 %.
    assert 1.1 < np.mean(normal) < 3.2
    assert np.mean(single) > 0.0


def test_trips_agree_until_the_box_is_moved(installations):
    agreeing, moved = [], []
    turn = np.radians(5.0)
    yawed = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    for _, _, fits in installations:
        past = joined([trip_evidence(fit) for fit in fits[:4]])
        now = trip_evidence(fits[4])
        agreeing.append(disagreement(past, now, Noise())[0])
        moved.append(disagreement(past, replace(now, R_va=yawed @ now.R_va), Noise())[0])
    assert max(agreeing) < 16.3  # 99.9 % of chi square with three degrees of freedom
    assert min(moved) > 16.3


def test_joining_in_steps_is_joining_at_once(installations):
    trips = [trip_evidence(fit) for fit in installations[0][2]]
    at_once = joined(trips)
    step_by_step = trips[0]
    for trip in trips[1:]:
        step_by_step = joined([step_by_step, trip])
    (one, P), (other, Q) = solved(at_once, Noise()), solved(step_by_step, Noise())
    assert np.degrees(np.linalg.norm(error_between(one, other))) < 0.01
    np.testing.assert_allclose(P, Q, rtol=0.01)
    assert step_by_step.trips == at_once.trips == len(trips)
    assert step_by_step.duration == at_once.duration


def test_a_trip_alone_keeps_its_estimate(installations):
    fit = installations[1][2][0]
    found, covariance = solved(trip_evidence(fit), Noise())
    assert np.degrees(np.linalg.norm(error_between(found, fit.R_va))) < 0.3
    assert np.all(np.diag(covariance) > 0.0)


def test_nothing_to_join_is_refused():
    with pytest.raises(ShapeError, match="at least one"):
        joined([])
    with pytest.raises(ShapeError, match="gram"):
        TripEvidence(np.eye(3), 0.0, 0.0, np.eye(3), 1.0)
