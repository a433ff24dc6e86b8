"""Drive files: one recording of one box, as columns and as the numerics' records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nav_core.records import Drive, Gnss, Inertial, Remark
from nav_core.typing import Flags
from server.errors import InvalidError
from server.formats import codec8e, compact, mcap_log, nmea, phone_csv
from server.formats.columns import NAMES, Columns, Floats, check_values
from server.formats.csv_text import header_of
from server.formats.csv_text import read as read_csv
from server.formats.parquet import read as read_parquet
from server.formats.tables import write_csv
from server.formats.thesis_line import is_thesis_line
from server.formats.thesis_line import read as read_thesis

# A clock that counts from 1970 and not from a boot.
_UNIX_S = 1e8
_FORCE, _RATE, _FIELD = ("fx", "fy", "fz"), ("wx", "wy", "wz"), ("mx", "my", "mz")
_FIX_COLUMNS = ("lat", "lon", "alt", "speed", "course", "fix")


def to_drive(columns: Columns) -> Drive:
    """Records of a recording: rows sorted stably, repeats dropped, both remarked; degrees become radians.

    A row is an inertial sample where it has specific force, and a fix report where it has any of
    lat, lon, alt, speed, course, fix.  Where `fix` is 0 the other values are not taken.
    """
    remarks = list(columns.remarks)
    sorted_values: Mapping[str, Floats] = columns.values
    sampled: Mapping[str, Flags] = columns.sampled
    moved = int(np.count_nonzero(np.diff(columns.values["t"]) < 0.0))
    if moved:
        remarks.append(Remark("rows_out_of_order", f"Time went back {moved} times; the rows were sorted"))
        order = np.argsort(columns.values["t"], kind="stable")
        sorted_values = {name: values[order] for name, values in columns.values.items()}
        sampled = {name: rows[order] for name, rows in sampled.items()}
    inertial = _inertial(sorted_values, sampled, remarks)
    gnss = _gnss(sorted_values, sampled, remarks)
    return Drive(inertial, gnss, tuple(remarks))


def _kept(name: str, values: Mapping[str, Floats], rows: np.ndarray, remarks: list[Remark]) -> np.ndarray:
    """Indices of the sampled rows without those that repeat the time before them."""
    index = np.flatnonzero(rows)
    t = values["t"][index]
    again = np.zeros(index.size, dtype=np.bool_)
    again[1:] = np.diff(t) == 0.0
    if again.any():
        remarks.append(Remark(f"{name}_rows_repeated", f"{int(again.sum())} {name} rows repeat a time; dropped"))
    return index[~again]


def _stacked(values: Mapping[str, Floats], names: tuple[str, ...], index: np.ndarray) -> Floats | None:
    if names[0] not in values:
        return None
    triads = np.column_stack([values[name][index] for name in names])
    return None if np.isnan(triads).all() else triads


def _optional(values: Mapping[str, Floats], name: str, index: np.ndarray) -> Floats | None:
    if name not in values:
        return None
    column = values[name][index]
    return None if np.isnan(column).all() else column


def _inertial(values: Mapping[str, Floats], sampled: Mapping[str, Flags], remarks: list[Remark]) -> Inertial:
    nothing = np.zeros(values["t"].size, dtype=np.bool_)
    forces = sampled.get("fx", nothing)
    others = sampled.get("wx", nothing) | sampled.get("mx", nothing)
    alone = int(np.count_nonzero(others & ~forces))
    if alone:
        remarks.append(Remark("rows_without_force", f"{alone} rows have a rate or field but no force; not used"))
    index = _kept("inertial", values, forces, remarks)
    force = _stacked(values, _FORCE, index)
    return Inertial(
        t=values["t"][index],
        f=np.zeros((0, 3)) if force is None else force,
        w=_stacked(values, _RATE, index),
        m=_stacked(values, _FIELD, index),
        temp=_optional(values, "temp", index),
    )


def _gnss(values: Mapping[str, Floats], sampled: Mapping[str, Flags], remarks: list[Remark]) -> Gnss:
    count = values["t"].size
    reported = np.zeros(count, dtype=np.bool_)
    for name in _FIX_COLUMNS:
        if name in values:
            reported |= sampled[name]
    index = _kept("gps", values, reported, remarks)
    nothing = np.full(index.size, np.nan)
    given = {name: values[name][index] if name in values else nothing for name in _FIX_COLUMNS}
    # A box that sends no fix flag says by sending a position or speed that it has one.
    present = ~np.isnan(given["lat"]) | ~np.isnan(given["speed"])
    fix = given["fix"] == 1.0 if "fix" in values else present

    def taken(name: str) -> Floats:
        return np.where(fix, given[name], np.nan)

    return Gnss(
        t=values["t"][index],
        lat=np.radians(taken("lat")),
        lon=np.radians(taken("lon")),
        alt=taken("alt"),
        speed=taken("speed"),
        course=np.radians(np.mod(taken("course"), 360.0)),
        fix=fix,
        hdop=_optional(values, "hdop", index),
        sats=_optional(values, "sats", index),
        utc=_optional(values, "utc", index),
    )


def join_gnss(parts: Sequence[Gnss]) -> Gnss:
    """Fixes of several batches on one clock in the order of time; of equal times the first part's stays."""
    t = np.concatenate([part.t for part in parts]) if parts else np.zeros(0)
    order = np.argsort(t, kind="stable")
    order = order[np.diff(t[order], prepend=-np.inf) > 0.0]
    columns: dict[str, Any] = {"t": t[order]}
    for name in ("lat", "lon", "alt", "speed", "course"):
        columns[name] = np.concatenate([getattr(part, name) for part in parts])[order] if parts else t
    for name in ("hdop", "sats", "utc"):
        full = _filled(parts, name)
        columns[name] = None if full is None else full[order]
    fix = np.concatenate([part.fix for part in parts])[order] if parts else np.zeros(0, dtype=np.bool_)
    return Gnss(fix=fix, **columns)


def join_inertial(parts: Sequence[Inertial]) -> Inertial:
    """Samples of batches of which each begins after the one before it ends."""
    t, f = np.concatenate([part.t for part in parts]), np.concatenate([part.f for part in parts])
    return Inertial(t, f, *(_filled(parts, name) for name in ("w", "m", "temp")))


def _filled(parts: Sequence[Gnss] | Sequence[Inertial], name: str) -> Floats | None:
    """An optional column of all parts, NaN for those without; None where all are."""
    values: list[Floats | None] = [getattr(part, name) for part in parts]
    known = next((value for value in values if value is not None), None)
    if known is None:
        return None
    nothing = [np.full((part.t.size, *known.shape[1:]), np.nan) for part in parts]
    return np.concatenate([one if value is None else value for value, one in zip(values, nothing, strict=True)])


def from_drive(drive: Drive) -> Columns:
    """Columns of a recording, one row for every time at which anything was sampled."""
    inertial, gnss = drive.inertial, drive.gnss
    t = np.union1d(inertial.t, gnss.t)
    at_inertial, at_gnss = np.searchsorted(t, inertial.t), np.searchsorted(t, gnss.t)
    values: Mapping[str, Floats] = {"t": t}

    def spread(name: str, index: np.ndarray, column: Floats) -> None:
        values[name] = np.full(t.size, np.nan)
        values[name][index] = column

    for names, triads in ((_FORCE, inertial.f), (_RATE, inertial.w), (_FIELD, inertial.m)):
        if triads is not None and inertial.t.size:
            for axis, name in enumerate(names):
                spread(name, at_inertial, triads[:, axis])
    if inertial.temp is not None:
        spread("temp", at_inertial, inertial.temp)
    if gnss.t.size:
        spread("lat", at_gnss, np.degrees(gnss.lat))
        spread("lon", at_gnss, np.degrees(gnss.lon))
        spread("alt", at_gnss, gnss.alt)
        spread("speed", at_gnss, gnss.speed)
        spread("course", at_gnss, np.mod(np.degrees(gnss.course), 360.0))
        spread("fix", at_gnss, gnss.fix.astype(np.float64))
        for name, column in (("hdop", gnss.hdop), ("sats", gnss.sats), ("utc", gnss.utc)):
            if column is not None:
                spread(name, at_gnss, column)
    return Columns(values)


class DriveFileError(ValueError):
    """A file holds no drive; says which file and why."""


def read_drive_columns(path: Path, *, thesis_course_clockwise: bool = False) -> Columns:
    """Checked columns of a file, its format known by its content (docs/device-protocol.md lists them)."""
    return read_columns(path.read_bytes(), str(path), thesis_course_clockwise=thesis_course_clockwise)


def read_columns(
    body: bytes, name: str, *, max_decoded_bytes: int | None = None, thesis_course_clockwise: bool = False
) -> Columns:
    """Checked columns of a file's content; `name` is what errors call it."""
    try:
        read = _reader_of(body, thesis_course_clockwise=thesis_course_clockwise)
        columns = _from_first_row(read(body, max_decoded_bytes=max_decoded_bytes))
        check_values(columns)
    except InvalidError as error:
        kinds = "CSV, Parquet, thesis line, compact batch, MCAP, NMEA, Codec 8E, a phone logger's CSV"
        raise DriveFileError(f"{name} is no drive file ({kinds}): {error.detail}") from error
    return columns


def _reader_of(body: bytes, *, thesis_course_clockwise: bool) -> Callable[..., Columns]:
    """The reader of a file's format; of a text that is nothing else, the one whose message helps most."""
    for magic, reader in ((b"PAR1", read_parquet), (compact.MAGIC, compact.read), (mcap_log.MAGIC, mcap_log.read)):
        if body.startswith(magic):
            return reader
    for fits, reader in (
        (codec8e.is_codec8e, codec8e.read),
        (nmea.is_nmea, nmea.read),
        (is_thesis_line, partial(read_thesis, course_clockwise=thesis_course_clockwise)),
    ):
        if fits(body):
            return reader
    foreign = not set(header_of(body)) <= set(NAMES) and phone_csv.is_phone_csv(body)
    return phone_csv.read if foreign else read_csv


def _from_first_row(columns: Columns) -> Columns:
    """Formats that only know UTC count from 1970: in a file, where nothing went before, their clock starts at 0."""
    t = columns.values["t"]
    if not t.size or not np.nanmin(t) > _UNIX_S:
        return columns
    began = float(np.floor(np.nanmin(t)))
    remark = Remark("clock_is_utc", f"Times count from 1970; t is the time since Unix second {began:.0f}")
    return Columns({**columns.values, "t": t - began}, (*columns.remarks, remark))


def read_drive_file(path: Path, *, thesis_course_clockwise: bool = False) -> Drive:
    """The recording in a file."""
    return to_drive(read_drive_columns(path, thesis_course_clockwise=thesis_course_clockwise))


def write_drive_csv(path: Path, columns: Columns) -> None:
    """Write a drive file as text."""
    path.write_bytes(write_csv(columns))


def write_drive_file(path: Path, columns: Columns) -> None:
    """Write a drive file: Parquet where the name ends so, else CSV."""
    if path.suffix.lower() == ".parquet":
        path.write_bytes(columns.to_parquet())
    else:
        write_drive_csv(path, columns)
