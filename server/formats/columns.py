"""Columns of float64: the one form that every format is decoded to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nav_core.records import Remark
from server.errors import InvalidError

Floats = NDArray[np.float64]

# Name, in the canonical order of the drive file, and the range outside which a value means nothing.
# The ranges are wide: they catch wrong units and broken decoders, not bad sensors.
RANGES: dict[str, tuple[float, float]] = {
    "t": (-1e10, 1e10),
    **dict.fromkeys(("fx", "fy", "fz"), (-1e5, 1e5)),  # m/s²
    **dict.fromkeys(("wx", "wy", "wz"), (-1e3, 1e3)),  # rad/s
    **dict.fromkeys(("mx", "my", "mz"), (-1e6, 1e6)),  # µT
    "temp": (-273.15, 1000.0),
    "lat": (-90.0, 90.0),
    "lon": (-180.0, 180.0),
    "alt": (-12_000.0, 100_000.0),
    "speed": (0.0, 1000.0),
    "course": (-360.0, 360.0),
    "fix": (0.0, 1.0),
    "hdop": (0.0, 10_000.0),
    "sats": (0.0, 1000.0),
    "utc": (0.0, 1e11),
    "battery": (0.0, 1000.0),
    "ignition": (0.0, 1.0),
}
NAMES = tuple(RANGES)
_FLAGS = ("fix", "ignition")
# A vector with a component missing is no vector; a position needs both coordinates.
_TOGETHER = (("fx", "fy", "fz"), ("wx", "wy", "wz"), ("mx", "my", "mz"), ("lat", "lon"))
_HASH_HEAD = b"scatola-columns-1\n"
_ONE_NAN = np.array(0x7FF8000000000000, dtype="<u8")


@dataclass(frozen=True, eq=False)
class Columns:
    """Equally long float64 columns in the canonical order; NaN where not sampled.

    Parameters
    ----------
    values : mapping of str to ndarray, shape (n,)
        Names and units of the drive file; `t` must be there.
    remarks : tuple of Remark
        What the reader of a foreign format had to assume or leave out; no part of the hash.
    named : mapping of str to (ndarray, ndarray)
        Times (as `t`) and values of what a foreign format tells of the vehicle and the drive file has no column for,
        kept as diagnosis values; no part of the hash and of the stored form.

    Raises
    ------
    InvalidError
        An unknown name, no `t`, unequal lengths.
    """

    values: dict[str, Floats]
    remarks: tuple[Remark, ...] = ()
    named: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict[str, tuple[Floats, Floats]])

    def __post_init__(self) -> None:
        check_names(self.values)
        ordered: dict[str, Floats] = {}
        for name in NAMES:
            if name in self.values:
                column = np.ascontiguousarray(self.values[name], dtype=np.float64).view()
                if column.shape != (len(self.values["t"]),):
                    raise InvalidError(
                        f"Column {name!r} has {column.size} rows, t has {len(self.values['t'])}", column=name
                    )
                column.flags.writeable = False
                ordered[name] = column
        object.__setattr__(self, "values", ordered)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.values["t"].size)

    @cached_property
    def sampled(self) -> dict[str, NDArray[np.bool_]]:
        """Which rows of each column have a value; what was sampled together has one mask, the same object."""
        masks: dict[bytes, NDArray[np.bool_]] = {}
        found: dict[str, NDArray[np.bool_]] = {}
        for name, column in self.values.items():
            mask = ~np.isnan(column)
            found[name] = masks.setdefault(np.packbits(mask).tobytes(), mask)
        return found

    @cached_property
    def samples(self) -> dict[str, Floats]:
        """The values of each column without the rows that have none."""
        places: dict[int, NDArray[np.intp] | None] = {}
        found: dict[str, Floats] = {}
        for name, column in self.values.items():
            mask = self.sampled[name]
            if id(mask) not in places:
                places[id(mask)] = None if mask.all() else np.flatnonzero(mask)
            place = places[id(mask)]
            found[name] = column if place is None else column[place]
        return found

    def column_sha256(self) -> str:
        """Canonical hash of names, types and values, whatever file they came in (docs/device-protocol.md)."""
        digest = hashlib.sha256(_HASH_HEAD)
        for name, column in self.values.items():
            values = column.astype("<f8", copy=False)
            missing = values.size - int(np.count_nonzero(self.sampled[name]))
            # Not-a-number has many bit patterns; one stands for all.
            if missing and np.count_nonzero(values.view("<u8") == _ONE_NAN) != missing:
                values = np.where(self.sampled[name], values, _ONE_NAN.view("<f8"))
            digest.update(f"{name} <f8 {values.size}\n".encode())
            digest.update(values.data)
        return digest.hexdigest()

    def to_parquet(self) -> bytes:
        """The stored form: Parquet with zstd, null where not sampled."""
        from server.formats.parquet_write import write

        return write(self)

    @staticmethod
    def from_parquet(data: bytes) -> Columns:
        """Read the stored form back."""
        from server.formats.parquet import read_stored

        return read_stored(data)


def check_names(names: Mapping[str, object] | tuple[str, ...]) -> None:
    """Raise unless all names are known and `t` is among them."""
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        raise InvalidError(f"Unknown columns: {', '.join(repr(name[:40]) for name in unknown[:5])}", code="columns")
    if "t" not in names:
        raise InvalidError("There is no column t", code="columns", column="t")
    for group in _TOGETHER:
        given = [name for name in group if name in names]
        if given and len(given) != len(group):
            raise InvalidError(
                f"Columns {', '.join(group)} come together; only {', '.join(given)} given", code="columns"
            )


def check_size(rows: int, columns: int, max_decoded_bytes: int | None) -> None:
    """Raise before columns are made that would not fit."""
    from server.errors import TooLargeError

    if max_decoded_bytes is not None and rows * columns * 8 > max_decoded_bytes:
        raise TooLargeError(f"{rows} rows of {columns} columns are more than {max_decoded_bytes} bytes once decoded")


def not_finite(column: str, row: int) -> InvalidError:
    """NaN or infinity came in where a number or nothing is allowed."""
    return InvalidError(
        f"Column {column!r}, row {row} (from 0) is NaN or infinite; leave out what was not sampled",
        code="not_finite",
        column=column,
        row=row,
    )


def check_values(columns: Columns) -> None:
    """Raise unless every value can mean something: ranges, whole vectors, a time in every row."""
    if columns.rows == 0:
        raise InvalidError("There are no rows", code="empty")
    if columns.samples["t"].size < columns.rows:
        row = int(np.argmin(columns.sampled["t"]))
        raise InvalidError(f"Row {row} (from 0) has no t", code="no_time", column="t", row=row)
    for name, samples in columns.samples.items():
        low, high = RANGES[name]
        # Told from the samples alone: most columns have a value now and then only.
        bad = samples.size and (samples.min() < low or samples.max() > high)
        if bad or (name in _FLAGS and ((samples != 0.0) & (samples != 1.0)).any()):
            raise _out_of_range(name, columns.values[name])
    for first, *others in _TOGETHER:
        if first not in columns.values:
            continue
        sampled = columns.sampled
        if any(sampled[first] is not sampled[other] for other in others):
            together = np.array([sampled[name] for name in (first, *others)])
            row = int(np.argmax(together.any(axis=0) & ~together.all(axis=0)))
            raise InvalidError(
                f"Row {row} (from 0) has only some of {', '.join((first, *others))}",
                code="partial",
                column=first,
                row=row,
            )


def _out_of_range(name: str, column: Floats) -> InvalidError:
    """Of a column's first value that is, as `check_values` found."""
    low, high = RANGES[name]
    bad = (column < low) | (column > high)
    if name in _FLAGS:
        bad |= (column != 0.0) & (column != 1.0) & ~np.isnan(column)
    row = int(np.argmax(bad))
    wanted = "0 or 1" if name in _FLAGS else f"{low:g}..{high:g}"
    return InvalidError(
        f"Column {name!r}, row {row} (from 0) is {column[row]:g}, expected {wanted}",
        code="out_of_range",
        column=name,
        row=row,
    )
