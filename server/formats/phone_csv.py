"""CSV of phone loggers: columns by what their headers say, units by the headers or the values, all of it remarked.

Written for the headers of AndroSensor, phyphox, Physics Toolbox, Sensor Logger and SensorLog, and read by words, so
that kindred apps are read too.  What the app computed itself (gravity taken out, orientation, steps) is not taken.
"""

from __future__ import annotations

import csv as lines
import io
import re
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute, csv

from nav_core.records import Remark
from server.errors import InvalidError
from server.formats.columns import Columns, Floats, check_size
from server.formats.lines import check_lines, first_line, lines_of
from server.formats.phone_sign import Sign, specific_force_sign
from server.formats.tables import CSV_BLOCK_BYTES, Filled, Table
from server.formats.thesis_line import held

_GRAVITY = 9.80665
_MAX_HEADER_BYTES = 16_384
_MAX_COLUMNS = 300
_HELD_S = 1.0
_EARTH_M = 6_371_000.0
_UNIX_S = (1e8, 1e11)
_TRIADS = (("fx", "fy", "fz"), ("wx", "wy", "wz"), ("mx", "my", "mz"))
_REPORT = ("lat", "lon", "alt", "speed", "course", "sats")
_DERIVED = frozenset(
    {"linear", "gravity", "user", "pedometer", "motion", "orientation", "uncalibrated", "accuracy", "google"}
)
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "force": {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "ms-2": 1.0, "g": _GRAVITY, "mg": _GRAVITY / 1000.0},
    "rate": {"rad/s": 1.0, "deg/s": np.pi / 180.0, "°/s": np.pi / 180.0, "dps": np.pi / 180.0},
    "field": {"ut": 1.0, "µt": 1.0, "μt": 1.0, "t": 1e6, "gauss": 100.0, "mt": 1e3, "nt": 1e-3},
    "speed": {
        "m/s": 1.0,
        "mps": 1.0,
        "km/h": 1 / 3.6,
        "kmh": 1 / 3.6,
        "kph": 1 / 3.6,
        "mph": 0.44704,
        "kn": 1852 / 3600,
    },
    "alt": {"m": 1.0, "ft": 0.3048},
}
Flags = NDArray[np.bool_]
_MISSING = ["", "nan", "NaN", "NAN", "null", "N/A", "-", "none"]
# pyarrow makes its functions when it is imported: no checker sees them.
_replace = vars(compute)["replace_substring"]


@dataclass(frozen=True, slots=True)
class _Source:
    """A column of the file that is taken, as which of ours."""

    index: int
    header: str
    quantity: str
    name: str
    unit: str | None


def is_phone_csv(body: bytes) -> bool:
    """Whether the header names a time and something measured."""
    try:
        found = _sources(_header(body)[0])
    except InvalidError:
        return False
    return any(source.name == "t" for source in found) and len(found) > 1


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of such a file, with what was detected as remarks."""
    header, delimiter = _header(body)
    sources = _sources(header)
    if not any(source.name == "t" for source in sources):
        raise InvalidError("No column of the header is a time", code="phone_csv")
    check_size(lines_of(body), len(sources), max_decoded_bytes)
    check_lines(body, "phone_csv")
    values = _values(body, header, delimiter, sources)
    remarks: list[Remark] = []
    taken: dict[str, Floats] = {}
    for quantity in dict.fromkeys(source.quantity for source in sources):
        group = [source for source in sources if source.quantity == quantity and source.index in values]
        _convert(quantity, group, values, taken, remarks)
    return _finished(taken, sources, remarks)


def _header(body: bytes) -> tuple[list[str], str]:
    """Names of the first line, and what separates them."""
    line = first_line(body, _MAX_HEADER_BYTES).removeprefix(b"\xef\xbb\xbf")
    try:
        text = line.decode()
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    delimiter = max(",;\t", key=text.count)
    names = next(lines.reader(io.StringIO(text), delimiter=delimiter), [])
    if not 2 <= len(names) <= _MAX_COLUMNS:
        raise InvalidError("The first line is no header of a logger", code="phone_csv")
    return [name.strip() for name in names], delimiter


def _sources(header: list[str]) -> list[_Source]:
    """The columns that are taken; the first that fits a name wins."""
    found: dict[str, _Source] = {}
    for index, text in enumerate(header):
        source = _source(index, text)
        if source is not None:
            found.setdefault(source.name, source)
    # A clock of the sensors beats the time of day.
    for index, text in enumerate(header):
        if re.fullmatch(r"seconds_elapsed|time since start.*|elapsed.*", text.strip().lower()):
            source = _source(index, text)
            if source is not None:
                found["t"] = source
    return list(found.values())


def _source(index: int, text: str) -> _Source | None:
    lower = text.lower()
    unit = re.search(r"\(([^()]*)\)", lower)
    words = set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower().replace("_", " ")))
    bare = re.sub(r"[^a-z]", "", re.sub(r"\([^()]*\)", "", lower))
    found = _quantity(bare, words)
    if found is None:
        return None
    quantity, name = found
    told = None if unit is None else unit.group(1).strip().replace(" ", "")
    if quantity == "time" and told is None and re.search(r"\bin ms\b", lower):
        told = "ms"
    if quantity == "time" and bare == "secondselapsed":
        told = "s"
    return _Source(index, text, quantity, name, told if told in _UNITS.get(quantity, {}) else None)


_CLOCKS = (
    "time", "t", "timestamp", "timesincestart", "timesincestartinms", "secondselapsed", "elapsed", "elapsedtime",
    "accelerometertimestampsincereboot",
)  # fmt: skip
_VECTORS = {
    "f": ("accelerometer", "accelerometeracceleration", "acceleration", "acc", "accel", "a", "gf", "gforce", "f", ""),
    "w": ("gyroscope", "gyro", "gyrorotation", "rotationrate", "angularvelocity", "w"),
    "m": ("magneticfield", "magnetometer", "mag", "magneticfieldstrength", "b"),
}
_SCALARS = {
    "lat": ("latitude", "lat"),
    "lon": ("longitude", "lon", "lng", "long"),
    "alt": ("altitude", "alt", "height", "elevation"),
    "speed": ("speed", "velocity"),
    "course": ("course", "bearing", "direction", "truecourse"),
    "sats": ("satellitesinrange", "satellites", "numsatellites"),
}
_NAMES: dict[str, tuple[str, str]] = {
    **dict.fromkeys(_CLOCKS, ("time", "t")),
    **{
        word + axis: ({"f": "force", "w": "rate", "m": "field"}[name], name + axis)
        for name, words in _VECTORS.items()
        for word in words
        for axis in "xyz"
    },
    **{
        place + word: (name if name in ("alt", "speed") else "count" if name == "sats" else "angle", name)
        for name, words in _SCALARS.items()
        for word in words
        for place in ("", "location", "gps")
    },
    "locationorientation": ("angle", "course"),  # AndroSensor's word for it
}


def _quantity(bare: str, words: set[str]) -> tuple[str, str] | None:
    """What a header names, and our name for it; `bare` is its letters alone, without the unit."""
    if words & _DERIVED and not bare.startswith("location"):
        return None
    return _NAMES.get(bare)


def _values(body: bytes, header: list[str], delimiter: str, sources: list[_Source]) -> dict[int, Floats]:
    """Numbers of the columns that are taken, by their index."""
    names = [f"c{index}" for index in range(len(header))]
    wanted = [names[source.index] for source in sources]
    filled = {source.index: Filled(source.name, lines_of(body)) for source in sources}
    try:
        blocks = csv.open_csv(
            pa.BufferReader(body),
            read_options=csv.ReadOptions(
                use_threads=False, block_size=CSV_BLOCK_BYTES, column_names=names, skip_rows=1, encoding="latin-1"
            ),
            parse_options=csv.ParseOptions(delimiter=delimiter, newlines_in_values=False),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(wanted, pa.string()),
                include_columns=wanted,
                strings_can_be_null=True,
                null_values=_MISSING,
                check_utf8=False,
            ),
        )
        for block in blocks:
            for source in sources:
                if source.index in filled and not _added(filled[source.index], source, block, delimiter):
                    del filled[source.index]
    except pa.ArrowInvalid as error:
        raise InvalidError(f"Not readable CSV: {str(error)[:200]}", code="phone_csv") from error
    return {index: column.values for index, column in filled.items()}


def _added(filled: Filled, source: _Source, block: Table, delimiter: str) -> bool:
    """Add a block's values of a column; False where they are none, and need not be."""
    texts = block.column(f"c{source.index}")
    try:
        numbers = (_replace(texts, ",", ".") if delimiter != "," else texts).cast(pa.float64())
    except pa.ArrowInvalid as error:
        if source.quantity == "count":  # "3 / 19": in use and in view, for people
            return False
        raise InvalidError(
            f"Column {source.header!r}: {str(error)[:120]}", code="phone_csv", column=source.header
        ) from error
    filled.add(numbers)
    return True


def _convert(
    quantity: str, group: list[_Source], values: dict[int, Floats], taken: dict[str, Floats], remarks: list[Remark]
) -> None:
    """Bring the columns of one quantity to SI, by the unit in the header or what the values tell."""
    if not group:
        return
    columns = {source.name: values.pop(source.index) for source in group}
    told = group[0].unit
    if quantity == "speed" and told is None:
        taken |= columns  # once the positions are there
        return
    unit = told if told is not None else _guess(quantity, list(columns.values()))
    factor = _UNITS.get(quantity, {}).get(unit, 1.0)
    if told is None and quantity in _UNITS:
        remarks.append(Remark(f"{quantity}_unit_detected", f"No unit in the header; the values look like {unit}"))
    for column in columns.values():
        with np.errstate(over="ignore"):  # infinite, and left out with a remark
            np.multiply(column, factor, out=column)  # in its place: a file may be large
    taken |= columns


_TYPICAL = {
    "force": {"m/s²": _GRAVITY, "g": 1.0, "mg": 1000.0},
    "field": {"µt": 45.0, "gauss": 0.45, "t": 45e-6, "nt": 45e3},
}


def _guess(quantity: str, columns: list[Floats]) -> str:
    """The unit in which values of this size make sense."""
    with np.errstate(over="ignore"):
        sizes = np.sqrt(np.sum(np.square(np.array(columns)), axis=0))
    sizes = sizes[np.isfinite(sizes)]
    typical = float(np.median(sizes)) if sizes.size else 0.0
    if quantity == "time":
        return _guess_time(typical, np.diff(columns[0]))
    if quantity == "rate":
        return "deg/s" if sizes.size and float(sizes.max()) > 35.0 else "rad/s"
    if quantity not in _TYPICAL or typical == 0.0:
        return "m"
    unit, size = min(_TYPICAL[quantity].items(), key=lambda known: abs(np.log(typical / known[1])))
    if quantity == "force" and not 0.5 < typical / size < 2.0:
        raise InvalidError(f"Accelerations of {typical:g} are neither m/s², g nor mg", code="phone_csv")
    return unit


def _guess_time(typical: float, steps: Floats) -> str:
    """The unit of a time: a Unix time by its size, elapsed time by its steps."""
    for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)):
        if typical >= least:
            return unit
    # Nobody logs a phone once a second or slower.
    return "ms" if typical < _UNIX_S[0] and steps.size and float(np.nanmedian(steps)) >= 1.0 else "s"


def _finished(taken: dict[str, Floats], sources: list[_Source], remarks: list[Remark]) -> Columns:
    """Rows with a time, whole vectors, reports taken once, the sign of the force."""
    timed = np.isfinite(taken["t"])
    if not timed.any():
        raise InvalidError("There is no row with a time", code="empty")
    values = taken
    if not timed.all():
        values = {name: column[timed] for name, column in taken.items()}
        remarks.append(Remark("rows_without_time", f"{int(np.count_nonzero(~timed))} rows without a time left out"))
    if (np.diff(values["t"]) < 0.0).any():
        order = np.argsort(values["t"], kind="stable")
        values = {name: column[order] for name, column in values.items()}
    for triad in _TRIADS:
        if all(name in values for name in triad):
            whole = np.isfinite([values[name] for name in triad])
            partial = whole.any(axis=0) & ~whole.all(axis=0)
            if partial.any():
                remarks.append(
                    Remark("vectors_incomplete", f"{int(partial.sum())} rows with only some of {triad} left out")
                )
                for name in triad:
                    values[name][partial] = np.nan
    speed_told = any(source.name == "speed" and source.unit is not None for source in sources)
    _take_reports(values, remarks, speed_told=speed_told)
    # iOS counts gravity as a pull down; its logger's headers are unmistakable.
    header_sign = -1 if any(source.header.startswith("accelerometerAcceleration") for source in sources) else 1
    _turn_force(values, header_sign, remarks)
    return Columns(values, tuple(remarks))


def _take_reports(values: dict[str, Floats], remarks: list[Remark], *, speed_told: bool) -> None:
    """Locations once each: loggers repeat the last one in every row."""
    names = [name for name in _REPORT if name in values]
    for name in ("speed", "course"):
        if name in values and (invalid := values[name] < 0.0).any():  # how iOS says "not known"
            values[name][invalid] = np.nan
            remarks.append(Remark(f"{name}_negative", f"{int(invalid.sum())} negative values of {name} left out"))
    if not {"lat", "lon"} <= values.keys():
        for name in names:
            del values[name]
        return
    present = np.isfinite(values["lat"]) & np.isfinite(values["lon"])
    rows = np.flatnonzero(present)
    again = held(values["t"][rows], np.column_stack([values[name][rows] for name in names]), _HELD_S)
    fresh = np.zeros(present.size, dtype=np.bool_)
    fresh[rows[~again]] = True
    if again.any():
        remarks.append(
            Remark("gps_reports_held", f"{int(again.sum())} rows repeat the location before them; taken once")
        )
    for name in names:
        values[name] = np.where(fresh, values[name], np.nan)
    values["fix"] = np.where(fresh, 1.0, np.nan)
    if _UNIX_S[0] < values["t"][0] < _UNIX_S[1]:
        values["utc"] = np.where(fresh, values["t"], np.nan)
    if "speed" in values and not speed_told:
        _scale_speed(values, fresh, remarks)


def _scale_speed(values: dict[str, Floats], fresh: Flags, remarks: list[Remark]) -> None:
    """Find the unit of speeds without one by the way between the positions."""
    rows = np.flatnonzero(fresh & np.isfinite(values["speed"]))
    lat, lon = np.radians(values["lat"][rows]), np.radians(values["lon"][rows])
    with np.errstate(invalid="ignore", divide="ignore"):
        way = _EARTH_M * np.hypot(np.diff(lat), np.diff(lon) * np.cos(lat[1:]))
        going = way / np.diff(values["t"][rows])
        ratios = 0.5 * (values["speed"][rows][1:] + values["speed"][rows][:-1]) / going
        ratios = ratios[(going > 2.0) & np.isfinite(ratios) & (ratios > 0.0)]
    unit = "m/s"
    if ratios.size >= 10:
        ratio = float(np.median(ratios))
        unit = min(("m/s", "km/h", "mph", "kn"), key=lambda name: abs(np.log(ratio * _UNITS["speed"][name])))
        remarks.append(Remark("speed_unit_detected", f"Speeds are {ratio:.2f} times the way in m/s: taken as {unit}"))
    else:
        remarks.append(Remark("speed_unit_assumed", "No unit of speed in the header, too little driving to tell: m/s"))
    values["speed"] = values["speed"] * _UNITS["speed"][unit]


def _turn_force(values: dict[str, Floats], header_sign: int, remarks: list[Remark]) -> None:
    """Make the readings specific force, up at rest."""
    names = _TRIADS[0]
    if not all(name in values for name in names):
        return
    rows = np.isfinite(values["fx"])
    found = Sign(0, 0.0, 0.0)
    if {"speed", "course"} <= values.keys():
        fixes = np.isfinite(values["speed"])
        force = np.column_stack([values[name][rows] for name in names])
        found = specific_force_sign(
            values["t"][rows], force, values["t"][fixes], values["speed"][fixes], values["course"][fixes]
        )
    fits = f"turns and braking fit {found.rotated:.2f} as it is, {found.mirrored:.2f} mirrored"
    sign = found.sign or header_sign
    word = "kept" if sign > 0 else "reversed"
    if found.sign:
        remarks.append(Remark("force_sign_detected", f"Sign of the accelerations {word}: {fits}"))
    else:
        remarks.append(
            Remark("force_sign_assumed", f"Sign of the accelerations {word}, as the header's app has it; {fits}")
        )
    if sign < 0:
        for name in names:
            values[name] = -values[name]
