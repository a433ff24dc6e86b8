"""A recording put together from batches: the short way gives what the long one gives, to the last bit."""

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest

from nav_core.simulate import Scenario, simulate
from server.events.window import Part, between, merged, recording
from server.formats.columns import Columns
from server.formats.drive import from_drive, to_drive

CUTS = (0.0, 9.0, 18.5, 30.0)


@pytest.fixture(scope="module")
def whole() -> Columns:
    drive, _ = simulate(Scenario(duration=30.0, accel_rate=100.0, gnss_rate=4.0, with_gyro=True), seed=3)
    columns = from_drive(drive)
    return Columns({**columns.values, "battery": np.full(columns.rows, 12.5)})


def plain(whole: Columns) -> list[Columns]:
    cuts = [between(whole, first, np.nextafter(last, first)) for first, last in pairwise(CUTS)]
    return [*cuts[:-1], between(whole, CUTS[-2], CUTS[-1])]


def changed(columns: Columns, **values: np.ndarray) -> Columns:
    return Columns({**columns.values, **values})


def without(columns: Columns, *names: str) -> Columns:
    return Columns({name: values for name, values in columns.values.items() if name not in names})


def again(columns: Columns, rows: slice) -> Columns:
    """The columns with some rows twice."""
    index = np.concatenate([np.arange(columns.rows), np.arange(columns.rows)[rows]])
    index.sort(kind="stable")
    return Columns({name: values[index] for name, values in columns.values.items()})


def nothing(columns: Columns, *names: str) -> Columns:
    return changed(columns, **dict.fromkeys(names, np.full(columns.rows, np.nan)))


CASES = {
    "one": lambda parts: parts[:1],
    "in line": lambda parts: parts,
    "out of turn": lambda parts: [parts[2], parts[0], parts[1]],
    "a part twice": lambda parts: [*parts, parts[1]],
    "rows twice": lambda parts: [parts[0], again(parts[1], slice(40, 60)), parts[2]],
    "rows out of order": lambda parts: [
        parts[0],
        Columns({name: values[::-1] for name, values in parts[1].values.items()}),
    ],
    "other columns": lambda parts: [parts[0], without(parts[1], "wx", "wy", "wz", "utc"), parts[2]],
    "no rate in one": lambda parts: [parts[0], nothing(parts[1], "wx", "wy", "wz"), parts[2]],
    "no rate in any": lambda parts: [nothing(part, "wx", "wy", "wz") for part in parts],
    "no time of fixes in one": lambda parts: [parts[0], nothing(parts[1], "utc")],
    "no force in one": lambda parts: [parts[0], nothing(parts[1], "fx", "fy", "fz"), parts[2]],
    "no fix in one": lambda parts: [parts[0], nothing(parts[1], "lat", "lon", "alt", "speed", "course", "fix")],
    "rows that tell nothing": lambda parts: [parts[0], nothing(parts[1], *list(parts[1].values)[1:]), parts[2]],
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("burst", [False, True])
def test_the_short_way_gives_what_the_long_one_gives(whole, case, burst):
    columns = CASES[case](plain(whole))
    parts = [Part(each, burst and number == 1) for number, each in enumerate(columns)]
    short, long = recording(parts), to_drive(merged(parts))
    assert short.remarks == long.remarks
    for one, other in ((short.inertial, long.inertial), (short.gnss, long.gnss)):
        for field in fields(one):
            ours, theirs = getattr(one, field.name), getattr(other, field.name)
            assert (ours is None) == (theirs is None), field.name
            if ours is not None:
                np.testing.assert_array_equal(ours, theirs, err_msg=field.name)


def test_what_is_known_already_is_not_made_again(whole):
    columns = plain(whole)[0]
    drive = to_drive(columns)
    assert Part(columns, burst=False, known=drive).drive is drive
