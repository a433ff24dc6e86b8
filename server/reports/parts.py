"""The report's tables, plots and sentences."""

from __future__ import annotations

import datetime as dt
import html
import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from reportlab.lib.styles import ParagraphStyle
from reportlab.platypus import Flowable, Paragraph, Table, TableStyle

from server.events.exports import utc_sigma_s
from server.reports.figures import basis_rows, clock_time, hours, number_rows, risk_rows
from server.reports.paper import (
    ACCENT,
    AXIS_X,
    AXIS_Y,
    BOLD,
    INK,
    LINE,
    MONO,
    MUTED,
    PAPER,
    PLAIN,
    Line,
    Plot,
    PlotFlow,
    faint,
)
from server.reports.sketch import VehicleSketch, WayMap
from server.reports.words import Words

if TYPE_CHECKING:
    from server.reports.pdf import Heading

CELL = ParagraphStyle("cell", fontName=PLAIN, fontSize=8.5, leading=11, textColor=INK)
HEAD = ParagraphStyle("head", fontName=PLAIN, fontSize=7.5, leading=10, textColor=MUTED)
HASH = ParagraphStyle("hash", fontName=MONO, fontSize=6.2, leading=8, textColor=INK, splitLongWords=1)
BIG = ParagraphStyle("big", fontName=BOLD, fontSize=17, leading=21, textColor=INK)
LINKS = (12, 6, 3)
"""So many uploads are listed: the first of these that the report has room for."""

_RULED = TableStyle(
    [
        ("LINEBELOW", (0, 0), (-1, -1), 0.4, LINE),
        ("VALIGN", (0, 0), (-1, -1), "MIDDLE"),
        ("LEFTPADDING", (0, 0), (-1, -1), 3),
        ("RIGHTPADDING", (0, 0), (-1, -1), 3),
        ("TOPPADDING", (0, 0), (-1, -1), 2.2),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 2.2),
    ]
)


def table(rows: list[list[Any]], shares: tuple[float, ...], width: float, *, headed: bool = True) -> Table:
    """A ruled table; text cells of the first row are heads."""
    first = 1 if headed else 0
    cells = [
        [
            cell if isinstance(cell, Flowable) else Paragraph(html.escape(str(cell)), HEAD if k < first else CELL)
            for cell in row
        ]
        for k, row in enumerate(rows)
    ]
    table = Table(cells, colWidths=[share * width for share in shares], repeatRows=first)
    table.setStyle(_RULED)
    return table


def pairs(rows: list[tuple[str, Any]], width: float) -> Table:
    """Names and values."""
    told = [[Paragraph(html.escape(name), HEAD), value] for name, value in rows]
    return table(told, (0.32, 0.68), width, headed=False)


def subject_table(document: dict[str, Any], heading: Heading, words: Words, at: dt.datetime, width: float) -> Table:
    """Which vehicle, which box, when, where."""
    way = document["curves"]["trajectory"]
    place = words("not_recorded")
    if way is not None:
        known = [k for k, lat in enumerate(way["lat_deg"]) if lat is not None]
        if known:
            k = min(known, key=lambda k: abs(way["t_s"][k]))
            lat, lon = way["lat_deg"][k], way["lon_deg"][k]
            place = f"{words.number(lat, 6)}°, {words.number(lon, 6)}° (WGS 84)"
    vehicle = heading.vehicle_name or words("no_vehicle")
    vehicle += f" ({words(document['inputs']['vehicle_class'])})" if heading.vehicle_name else ""
    when = f"{words.date(at.year, at.month, at.day)}, {clock_time(at, words)}"
    clock = f"{words('boot')} {document['subject']['boot']}: {words.number(document['event']['t0_s'], 3)} s"
    rows = [
        (words("vehicle"), vehicle),
        (words("plate"), heading.plate or words("not_recorded")),
        (words("box"), f"{heading.device_name} · {document['subject']['device_id']}"),
        (words("time"), f"{when} · {clock}"),
        (words("place"), place),
    ]
    return pairs(rows, width)


def key_figures(document: dict[str, Any], words: Words, width: float) -> Table:
    """The four numbers that everybody asks for."""
    event = document["event"]
    at_least = event["pulse"] is not None and event["pulse"]["peak_is_lower_bound"]
    dv, dv_interval = event["delta_v_kmh"]["resultant"], event["delta_v_interval95_kmh"]["resultant"]
    by_clock = "" if event["pdof_clock"] is None else hours(event["pdof_clock"], words)
    figures = [
        (words("key_dv"), words.number(dv, 1), "km/h", words.interval(dv_interval, 1)),
        (
            words("key_pdof"),
            words.number(event["pdof_deg"], 1) + ("" if event["pdof_deg"] is None else "°"),
            "",
            words.interval(event["pdof_interval95_deg"], 1) + (f"<br/>{by_clock}" if by_clock else ""),
        ),
        (
            words("key_speed"),
            words.number(event["impact_speed_kmh"], 1),
            "km/h",
            words.interval(event["impact_speed_interval95_kmh"], 1),
        ),
        (words("key_peak"), words.number(event["peak_g"], 1), "g", words("at_least") if at_least else "\N{EN DASH}"),
    ]
    heads, values, intervals = [], [], []
    for name, value, unit, interval in figures:
        missing = value == words("not_recorded")
        heads.append(Paragraph(name, HEAD))
        told = f'<font size="10">{value}</font>' if missing else f'{value} <font size="9" color="#5a6572">{unit}</font>'
        values.append(Paragraph(told, BIG))
        intervals.append(Paragraph("" if missing else interval, CELL))
    table = Table([heads, values, intervals], colWidths=[0.25 * width] * 4)
    table.setStyle(
        TableStyle(
            [
                ("BACKGROUND", (0, 0), (-1, -1), PAPER),
                ("LINEBEFORE", (1, 0), (-1, -1), 0.5, LINE),
                ("VALIGN", (0, 0), (-1, -1), "TOP"),
                ("LEFTPADDING", (0, 0), (-1, -1), 8),
                ("TOPPADDING", (0, 0), (-1, 0), 6),
                ("BOTTOMPADDING", (0, 2), (-1, 2), 7),
                ("TOPPADDING", (0, 1), (-1, 2), 0),
            ]
        )
    )
    return table


def sketch(document: dict[str, Any], words: Words, width: float) -> Flowable:
    """The vehicle and the force."""
    return VehicleSketch(document["event"], document["inputs"]["vehicle_class"], words, width, 200)


def pulse_plots(pulse: dict[str, Any], words: Words, width: float) -> list[Flowable]:
    """Delta-V with its band, and the pulse as recorded and as estimated."""
    t = [1e3 * value for value in pulse["t_s"]]
    decimal = "." if words.language == "en" else ","
    x, y = pulse["delta_v_kmh_x"], pulse["delta_v_kmh_y"]
    bands = []
    for values, colour in ((x, AXIS_X), (y, AXIS_Y)):
        reach = [1.96 * sigma if time >= 0.0 else 0.0 for sigma, time in zip(pulse["sigma_kmh"], t, strict=True)]
        low = [a - b for a, b in zip(values, reach, strict=True)]
        high = [a + b for a, b in zip(values, reach, strict=True)]
        bands.append((t, low, high, faint(colour, 0.18)))
    resultant = [math.hypot(a, b) for a, b in zip(x, y, strict=True)]
    delta_v = Plot(
        words("plot_dv") + f" · {words('band')}",
        words("ms"),
        [
            Line(t, x, AXIS_X, name=words("along")),
            Line(t, y, AXIS_Y, name=words("across")),
            Line(t, resultant, INK, width=0.9, dash=(3, 2), name=words("resultant")),
        ],
        bands=bands,
        decimal=decimal,
    )
    lines = [
        Line(t, pulse[f"recorded_g_{axis}"], colour, name=f"{words(name)}, {words('recorded')}")
        for axis, colour, name in (("x", AXIS_X, "along"), ("y", AXIS_Y, "across"))
    ]
    marks: list[tuple[float, float]] = []
    if any(pulse["clipped"]):
        lines += [
            Line(t, pulse[f"acceleration_g_{axis}"], colour, width=0.9, dash=(2.5, 2), name=name)
            for axis, colour, name in (("x", AXIS_X, words("estimated")), ("y", AXIS_Y, ""))
        ]
        rows = zip(t, pulse["recorded_g_x"], pulse["clipped"], strict=True)
        marks = [(time, value) for time, value, clipped in rows if clipped]
    shock = Plot(words("plot_pulse"), words("ms"), lines, marks=marks, marks_name=words("full_scale"), decimal=decimal)
    return [PlotFlow(delta_v, width, 205), PlotFlow(shock, width, 205)]


def speed_plot(way: dict[str, Any], words: Words, width: float) -> Flowable:
    """Speed with its band from 30 s before to 30 s after."""
    speed, sigma = way["speed_kmh"], way["speed_sigma_kmh"]
    low = [None if v is None or s is None else max(v - 1.96 * s, 0.0) for v, s in zip(speed, sigma, strict=True)]
    high = [None if v is None or s is None else v + 1.96 * s for v, s in zip(speed, sigma, strict=True)]
    plot = Plot(
        words("plot_speed") + f" · {words('band')}",
        words("s"),
        [Line(way["t_s"], speed, ACCENT)],
        bands=[(way["t_s"], low, high, faint(ACCENT, 0.2))],
        decimal="." if words.language == "en" else ",",
    )
    return PlotFlow(plot, width, 175)


def maps(document: dict[str, Any], words: Words, width: float) -> tuple[Table, str]:
    """The whole way, and the place of the impact close up."""
    way, event = document["curves"]["trajectory"], document["event"]
    rest = None if event["rest"] is None else event["rest"]["t_s"] - event["t0_s"]
    others = [each["t0_s"] - event["t0_s"] for each in event["second_impacts"]]
    half = 0.5 * width - 5
    whole, near = (
        WayMap(way, words, half, 235, title=words(title), span_s=span_s, rest=rest, others=others)
        for title, span_s in (("map_all", (-30.0, 30.0)), ("map_near", (-3.0, 8.0)))
    )
    table = Table([[whole, near]], colWidths=[half + 10, half])
    table.setStyle(TableStyle([("LEFTPADDING", (0, 0), (-1, -1), 0), ("RIGHTPADDING", (0, 0), (-1, -1), 0)]))
    return table, words("map_note", grid=f"{words.short(whole.grid)}; {words.short(near.grid)}")


def driver_tables(event: dict[str, Any], words: Words, width: float) -> list[Flowable]:
    """The last five seconds, and what they amount to."""
    driver, number = event["driver"], words.number
    heads = [words(key) for key in ("d_t", "d_v", "d_a", "d_y", "d_r")]
    rows = [
        [
            number(row["t_s"], 1),
            number(row["speed_kmh"], 0),
            number(row["longitudinal_mps2"], 1),
            number(row["lateral_mps2"], 1),
            number(row["yaw_rate_deg_s"], 1),
        ]
        for row in driver["last_5_s"]
    ]
    braked = words("d_none")
    if driver["braked_from_s"] is not None:
        braked = words("d_from", t=number(driver["braked_from_s"], 1), a=number(driver["braking_mps2"], 1))
    stop = driver["stopping_distance_m"]
    facts = [
        (words("d_brake"), braked),
        (words("d_steer"), words(driver["steered"] or "not_recorded")),
        (words("d_stop"), words("not_recorded") if stop is None else f"{number(stop, 0)} m"),
    ]
    return [table([heads, *rows], (0.2,) * 5, width), pairs(facts, width)]


def provenance_tables(
    document: dict[str, Any], event_sha256: str, words: Words, width: float, links: int
) -> list[Flowable]:
    """Versions and hashes."""
    inputs, software = document["inputs"], document["software"]
    clock, mounting = inputs["clock"], inputs["mounting"]
    how = "p_clock_gnss" if clock["source"] == "gnss" else "p_clock_arrival"
    rows = [
        (words("p_software"), f"{software['name']} {software['version']}"),
        (words("p_algorithm"), document["algorithm"]),
        (words("p_event"), Paragraph(event_sha256, HASH)),
        (words("p_inputs"), Paragraph(inputs["sha256"], HASH)),
        (words("p_mounting"), f"{mounting['method']} · {mounting['algorithm'] or words('not_recorded')}"),
        (words("p_clock"), words(how, s=words.spread(utc_sigma_s(document)))),
    ]
    heads: list[Any] = [words(key) for key in ("p_link", "p_stream", "p_span", "p_body", "p_columns")]
    # The batches that hold time zero are never among those left out.
    t0 = document["event"]["t0_s"]
    ranked = sorted(inputs["batches"], key=lambda b: max(b["t_first_s"] - t0, t0 - b["t_last_s"]))
    shown = sorted(ranked[:links], key=lambda b: b["chain_index"])
    listed = [
        [
            str(batch["chain_index"]),
            words(batch["stream"]),
            f"{words.number(batch['t_first_s'], 1)} … {words.number(batch['t_last_s'], 1)}",
            Paragraph(batch["body_sha256"], HASH),
            Paragraph(batch["column_sha256"], HASH),
        ]
        for batch in shown
    ]
    found: list[Flowable] = [pairs(rows, width), table([heads, *listed], (0.08, 0.12, 0.18, 0.31, 0.31), width)]
    left = len(inputs["batches"]) - len(shown)
    if left:
        found.append(Paragraph(words("link_more", n=left), HEAD))
    return found


def numbers_table(event: dict[str, Any], words: Words, width: float) -> Table:
    """Every number with its interval; what is not known is not recorded."""
    heads = [words(key) for key in ("n_name", "n_value", "n_interval", "n_unit")]
    return table([heads, *map(list, number_rows(event, words))], (0.46, 0.18, 0.22, 0.14), width)


def risk_table(event: dict[str, Any], words: Words, width: float) -> Table:
    """Probabilities by published curves."""
    heads = [words(key) for key in ("r_curve", "r_people", "r_level", "r_p", "n_interval")]
    rows = [list(row) for row in risk_rows(event, words)]
    for above, row in reversed(list(pairwise(rows))):
        # Whom several curves are of is said once.
        row[1] = "" if row[1] == above[1] else row[1]
    return table([heads, *rows], (0.22, 0.42, 0.1, 0.11, 0.15), width)


def basis_table(document: dict[str, Any], words: Words, width: float) -> Table:
    """Rate, full scale, fixes, lag, mounting."""
    return pairs(list(basis_rows(document, words)), width)
