"""The straight line through a mounting: found where the box slips, not where trips differ."""

from __future__ import annotations

import numpy as np
import pytest

from nav_core.mounting.fixes import Fixes
from nav_core.mounting.model import TURN, UNKNOWNS, Noise
from nav_core.mounting.refine import BLOCK, Fit, view_of
from nav_core.mounting.slip import steady_slip
from nav_core.mounting.stretch import PAUSE, Record

BLOCKS = 180
SIGMA = np.radians(1.0)
"""Of what one block tells of each axis."""


def _fit(turns: np.ndarray, driving: np.ndarray, seed: int) -> Fit:
    """Of a drive in which each block saw the mounting turned by so much, alike about each axis."""
    rng = np.random.default_rng(seed)
    gram = np.zeros((BLOCKS, 1 + UNKNOWNS, 1 + UNKNOWNS))
    for block in np.flatnonzero(driving):
        for axis in range(3):
            row = np.zeros(1 + UNKNOWNS)
            row[0], row[1 + axis] = -(turns[block] + SIGMA * rng.standard_normal()) / SIGMA, 1.0 / SIGMA
            gram[block] += np.outer(row, row)
    three = np.arange(3.0)
    standing = Record(three, np.zeros((3, 3)), three, Fixes(three, 0.0 * three, 0.0 * three, 0.0 * three), three)
    bare = Fit(
        R_va=np.eye(3),
        p=np.zeros(UNKNOWNS),
        speed_lag=0.0,
        course_lag=0.0,
        noise=Noise(),
        gram=gram,
        misfit=np.zeros((BLOCKS, 4)),
        count=np.outer(driving, np.ones(4)),
        prior=np.where(np.arange(UNKNOWNS) < TURN.stop, 0.0, 1.0),
        prior_pull=np.zeros(UNKNOWNS),
        begin=0.0,
        view=view_of(standing, np.eye(3), (0.0, 0.0)),
    )
    bare.p[:] = bare.solve(gram.sum(0))[0]
    return bare


def _parked(*spans: tuple[int, int]) -> np.ndarray:
    driving = np.ones(BLOCKS, dtype=bool)
    for begin, end in spans:
        driving[begin:end] = False
    return driving


LINE = np.radians(3.0) * np.linspace(-0.5, 0.5, BLOCKS)


def test_a_line_within_one_trip_is_found():
    found = np.array([steady_slip(_fit(LINE, _parked(), seed)) for seed in range(20)])
    assert np.abs(found.mean(0) - np.radians(3.0)).max() < np.radians(0.15)


@pytest.mark.parametrize("gap", [PAUSE, 3 * PAUSE])
def test_a_line_that_goes_on_through_a_pause_is_found(gap: float):
    pause = round(gap / BLOCK) + 2
    found = steady_slip(_fit(LINE, _parked((80, 80 + pause)), 1))
    assert np.all(np.abs(found - np.radians(3.0)) < np.radians(1.0))


def test_trips_that_differ_by_what_trips_differ_by_are_no_slip():
    """The bank of the roads and the load are new in every trip; only a pause tells a step from a line."""
    step = np.where(np.arange(BLOCKS) < 90, -0.5, 0.5) * np.radians(1.2)
    with_pause, without = (
        np.array([steady_slip(_fit(step, driving, seed))[0] for seed in range(20)])
        for driving in (_parked((75, 105)), _parked())
    )
    assert not np.any(with_pause)
    assert np.count_nonzero(without) >= 10


def test_a_fixed_box_does_not_slip():
    found = np.array([steady_slip(_fit(np.zeros(BLOCKS), _parked(), seed)) for seed in range(200)])
    assert np.count_nonzero(found) <= 1  # of 600 axes, one in two thousand
