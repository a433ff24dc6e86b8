"""NMEA 0183 logs: GGA, RMC, VTG, GNS, ZDA of any talker, one report for each moment of the receiver.

A logger's own stamp in seconds before the `$` becomes `t`; without stamps `t` is the receiver's UTC, so that the lag of
the reports cannot show in it.  A line with a wrong checksum, or one that cannot be read, is left out and counted.
"""

from __future__ import annotations

import datetime as dt
import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from nav_core.records import Remark
from server.errors import InvalidError
from server.formats.columns import Columns, check_size
from server.formats.lines import lines_of

_SENTENCE = re.compile(
    r"\s*(?:(?P<stamp>\d{1,12}(?:\.\d{1,9})?)[\s,;:]+)?"
    r"\$(?P<body>[A-Z]{2}(?P<kind>[A-Z]{3}),[^*$]{0,120})(?:\*(?P<sum>[0-9A-Fa-f]{2}))?\s*"
)
_TIME = re.compile(r"(\d{2})(\d{2})(\d{2}(?:\.\d{1,6})?)")
_ANGLE = re.compile(r"(\d{1,3})(\d{2}(?:\.\d{1,9})?)")
_NUMBER = re.compile(r"-?\d{1,9}(?:\.\d{0,9})?")
_KNOT_MPS = 1852.0 / 3600.0
_DAY_S = 86_400.0
_MAX_LINE_BYTES = 1024
_KINDS = frozenset({"GGA", "RMC", "VTG", "GNS", "ZDA"})


@dataclass(slots=True)
class _Report:
    """What the sentences of one moment say."""

    second: float
    """Of the day, UTC."""
    stamp: float | None
    midnight: float | None = None
    """Unix time at which the day began, where a sentence tells the date."""
    values: dict[str, float] = field(default_factory=dict[str, float])


def is_nmea(body: bytes) -> bool:
    """Whether one of the first lines is a sentence of a receiver."""
    return any(_SENTENCE.fullmatch(line) for line in body[:4096].decode("ascii", "replace").splitlines()[:20])


def read(body: bytes, *, max_decoded_bytes: int | None) -> Columns:
    """Columns of a log."""
    # Before lines are made, each an object many times its length; while they are read, reports are objects.
    check_size(4 * lines_of(body), 12, max_decoded_bytes)
    left_out: Counter[str] = Counter()
    reports: list[_Report] = []
    first_bad = 0
    for number, raw in enumerate(body.splitlines(), start=1):
        if not raw or raw.isspace():
            continue
        # The pattern would be tried at every place of a line of megabytes.
        long = len(raw) > _MAX_LINE_BYTES
        why = "no NMEA sentence" if long else _take(raw.decode("ascii", "replace"), reports)
        if why is not None:
            left_out[why] += 1
            first_bad = first_bad or number
    if not reports:
        raise InvalidError(
            f"No sentence with a time could be read; line {first_bad or 1} is the first bad one", code="nmea"
        )
    return _columns(reports, left_out, first_bad)


def _take(line: str, reports: list[_Report]) -> str | None:
    """Add a line to the report of its moment; why it was left out."""
    match = _SENTENCE.fullmatch(line)
    if match is None:
        return "no NMEA sentence"
    if match["sum"] is not None:
        found = 0
        for character in match["body"]:
            found ^= ord(character)
        if found != int(match["sum"], 16):
            return "wrong checksum"
    if match["kind"] not in _KINDS:
        return None  # satellites in view and the like: nothing is lost that a column would hold
    stamp = None if match["stamp"] is None else float(match["stamp"])
    try:
        _read_sentence(match["kind"], match["body"].split(",")[1:], stamp, reports)
    except (ValueError, IndexError):
        return "unreadable fields"
    return None


def _read_sentence(kind: str, fields: list[str], stamp: float | None, reports: list[_Report]) -> None:
    if kind == "VTG":  # has no time: it belongs to the report before it
        if reports and fields[0]:
            reports[-1].values["course"] = _in_circle(fields[0])
        if reports and fields[6]:
            reports[-1].values["speed"] = _number(fields[6]) / 3.6
        return
    if not fields[0]:
        return
    values: dict[str, float] = {}
    midnight = None
    if kind == "ZDA":
        if not all(fields[1:4]):
            return
        midnight = _midnight(int(fields[3]), int(fields[2]), int(fields[1]))
    elif kind == "RMC":
        if len(fields[8]) == 6:
            midnight = _midnight(2000 + int(fields[8][4:]), int(fields[8][2:4]), int(fields[8][:2]))
        values["fix"] = float(fields[1] == "A")
        values |= _position(fields[2:6])
        values |= {"speed": _number(fields[6]) * _KNOT_MPS} if fields[6] else {}
        values |= {"course": _in_circle(fields[7])} if fields[7] else {}
    else:  # GGA and GNS agree in their first nine fields
        values["fix"] = float(fields[5].strip("N0") != "")
        values |= _position(fields[1:5])
        for name, text in zip(("sats", "hdop", "alt"), fields[6:9], strict=True):
            values |= {name: _number(text)} if text else {}
    report = _report_of(_second(fields[0]), stamp, reports)
    report.values |= values
    report.midnight = midnight if midnight is not None else report.midnight


def _report_of(second: float, stamp: float | None, reports: list[_Report]) -> _Report:
    """The report of this moment, a new one unless it is the last."""
    if not reports or reports[-1].second != second:
        reports.append(_Report(second, stamp))
    return reports[-1]


def _second(text: str) -> float:
    match = _TIME.fullmatch(text)
    if match is None:
        raise ValueError(text)
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3])


def _midnight(year: int, month: int, day: int) -> float:
    return dt.datetime(year, month, day, tzinfo=dt.UTC).timestamp()


def _number(text: str) -> float:
    if _NUMBER.fullmatch(text) is None:  # float() would also take "nan" and "1e999"
        raise ValueError(text)
    return float(text)


def _in_circle(text: str) -> float:
    return _number(text) % 360.0


def _position(fields: list[str]) -> dict[str, float]:
    """Latitude and longitude from degrees with minutes and a hemisphere."""
    if not all(fields):
        return {}
    degrees: list[float] = []
    for text, hemisphere, signs in ((fields[0], fields[1], "NS"), (fields[2], fields[3], "EW")):
        match = _ANGLE.fullmatch(text)
        if match is None or hemisphere not in signs:
            raise ValueError(text)
        angle = int(match[1]) + float(match[2]) / 60.0
        if angle > (90.0 if signs == "NS" else 180.0):
            raise ValueError(text)
        degrees.append(angle if hemisphere == signs[0] else -angle)
    return {"lat": degrees[0], "lon": degrees[1]}


def _columns(reports: list[_Report], left_out: Counter[str], first_bad: int) -> Columns:
    remarks = [
        Remark("nmea_lines_left_out", f"{count} lines left out: {why}; the first bad one is line {first_bad}")
        for why, count in sorted(left_out.items())
    ]
    utc = _utc(reports)
    stamped = all(report.stamp is not None for report in reports)
    if utc is None:
        remarks.append(Remark("nmea_without_date", "No sentence tells the date: there is no UTC"))
    if not stamped:
        remarks.append(Remark("nmea_clock", "The log has no stamps of its own: t is the receiver's time, without lag"))
    seconds = _unwrapped([report.second for report in reports]) if utc is None else utc
    names = {name for report in reports for name in report.values}
    values = {name: np.array([report.values.get(name, np.nan) for report in reports]) for name in names}
    values["t"] = np.array([report.stamp for report in reports], dtype=np.float64) if stamped else np.array(seconds)
    if utc is not None:
        values["utc"] = np.array(utc)
    return Columns(values, tuple(remarks))


def _unwrapped(seconds: list[float]) -> list[float]:
    """Seconds that go on past midnight."""
    days, out = 0.0, list[float]()
    for index, second in enumerate(seconds):
        if index and second + days < out[-1] - _DAY_S / 2.0:
            days += _DAY_S
        out.append(second + days)
    return out


def _utc(reports: list[_Report]) -> list[float] | None:
    """Unix time of each report: dates where they are told, carried from the nearest such report elsewhere."""
    seconds = _unwrapped([report.second for report in reports])
    offsets = [
        None if report.midnight is None else report.midnight + report.second - second
        for report, second in zip(reports, seconds, strict=True)
    ]
    known = next((offset for offset in offsets if offset is not None), None)
    if known is None:
        return None
    out: list[float] = []
    for offset, second in zip(offsets, seconds, strict=True):
        known = known if offset is None else offset
        out.append(known + second)
    return out
