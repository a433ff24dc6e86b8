"""The thesis' text line (001 §5.1): eleven fields without a header, by blanks or commas.

Sample number, time since the start in ms, longitude and latitude in degrees, altitude in m, speed
in km/h, course in degrees (counter-clockwise from north), fix, and three specific forces in per cent
of g.  The thesis' text gives the sampling periods in ms; they are s, the times in the file are ms.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from server.errors import InvalidError
from server.formats.columns import Columns, Floats, check_size
from server.formats.lines import check_lines, lines_of

FIELDS = 11
STANDARD_GRAVITY = 9.81
"""What the thesis takes 100 % to be, m/s²."""
_GPS_PERIOD_S = 0.25


def is_thesis_line(body: bytes) -> bool:
    """Whether a text's first line is eleven numbers."""
    lines = body[:4096].lstrip().splitlines()
    return bool(lines) and _numbers(lines[0].decode("ascii", "replace")) is not None


def _numbers(line: str) -> list[float] | None:
    fields = line.replace(",", " ").split()
    if len(fields) != FIELDS:
        return None
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None


def read(body: bytes, *, max_decoded_bytes: int | None = None, course_clockwise: bool = False) -> Columns:
    """Columns of such a file; a GPS report that is held over the following rows is taken once."""
    # Lists of Python floats stand for a while where the columns will be.
    check_size(4 * lines_of(body), FIELDS, max_decoded_bytes)
    check_lines(body, "thesis_line")
    rows: list[list[float]] = []
    for number, raw in enumerate(body.splitlines(), start=1):
        line = raw.decode("ascii", "replace")
        if not line.strip():
            continue
        row = _numbers(line)
        if row is None or not all(map(math.isfinite, row)):
            raise InvalidError(f"Line {number} is not {FIELDS} numbers", code="thesis_line", row=number)
        rows.append(row)
    if not rows:
        raise InvalidError("There are no rows", code="empty")
    _, time_ms, lon, lat, alt, speed_kmh, course, fix, *percent = np.array(rows, dtype=np.float64).T
    clockwise = course if course_clockwise else np.mod(-course, 360.0)
    reports = np.column_stack([lon, lat, alt, speed_kmh, course, fix])
    fresh = ~held(time_ms / 1000.0, reports, _GPS_PERIOD_S)
    with_fix = fresh & (fix == 1.0)
    fx, fy, fz = (axis * (STANDARD_GRAVITY / 100.0) for axis in percent)

    def taken(values: Floats) -> Floats:
        return np.where(with_fix, values, np.nan)

    return Columns(
        {
            "t": time_ms / 1000.0,
            "fx": fx,
            "fy": fy,
            "fz": fz,
            "lat": taken(lat),
            "lon": taken(lon),
            "alt": taken(alt),
            "speed": taken(speed_kmh / 3.6),
            "course": taken(clockwise),
            "fix": np.where(fresh, fix, np.nan),
        }
    )


def held(t: Floats, reports: Floats, period_s: float) -> NDArray[np.bool_]:
    """Rows that only repeat the GPS report before them because the next one is not due yet."""
    repeats = np.zeros(t.size, dtype=np.bool_)
    taken_at = -np.inf
    changed = np.ones(t.size, dtype=np.bool_)
    before, after = reports[:-1], reports[1:]
    changed[1:] = ((before != after) & ~(np.isnan(before) & np.isnan(after))).any(axis=1)
    for row, (at, new) in enumerate(zip(t.tolist(), changed.tolist(), strict=True)):
        if new or at - taken_at >= period_s:
            taken_at = at
        else:
            repeats[row] = True
    return repeats
