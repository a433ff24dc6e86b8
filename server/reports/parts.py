"""The report's tables, plots and sentences."""

from __future__ import annotations

import datetime as dt
import html
import math
from typing import TYPE_CHECKING, Any

from reportlab.lib.styles import ParagraphStyle
from reportlab.platypus import Flowable, Paragraph, Table, TableStyle

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
STRONG = ParagraphStyle("strong", parent=CELL, fontName=BOLD)
HASH = ParagraphStyle("hash", fontName=MONO, fontSize=6.2, leading=8, textColor=INK, splitLongWords=1)
BIG = ParagraphStyle("big", fontName=BOLD, fontSize=17, leading=21, textColor=INK)
MAX_LINKS = 12

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


def _table(rows: list[list[Any]], shares: tuple[float, ...], width: float, *, headed: bool = True) -> Table:
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


def _pairs(rows: list[tuple[str, Any]], width: float) -> Table:
    """Names and values."""
    told = [[Paragraph(html.escape(name), HEAD), value] for name, value in rows]
    return _table(told, (0.32, 0.68), width, headed=False)


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
    rows = [
        (words("vehicle"), vehicle),
        (words("plate"), heading.plate or words("not_recorded")),
        (words("box"), f"{heading.device_name} · {document['subject']['device_id']}"),
        (words("time"), f"{when} · {words('boot')} {document['subject']['boot']}: {document['event']['t0_s']:.3f} s"),
        (words("place"), place),
    ]
    return _pairs(rows, width)


def clock_time(at: dt.datetime, words: Words) -> str:
    """Time of day with hundredths."""
    text = at.strftime("%H:%M:%S.%f")[:-4]
    return text if words.language == "en" else text.replace(".", ",")


def key_figures(document: dict[str, Any], words: Words, width: float) -> Table:
    """The four numbers that everybody asks for."""
    event = document["event"]
    at_least = event["pulse"] is not None and event["pulse"]["peak_is_lower_bound"]
    dv, dv_interval = event["delta_v_kmh"]["resultant"], event["delta_v_interval95_kmh"]["resultant"]
    hours = "" if event["pdof_clock"] is None else _hours(event["pdof_clock"], words)
    figures = [
        (words("key_dv"), words.number(dv, 0), "km/h", words.interval(dv_interval, 0)),
        (
            words("key_pdof"),
            words.number(event["pdof_deg"], 0),
            "°" + (f" · {hours}" if hours else ""),
            words.interval(event["pdof_interval95_deg"], 0),
        ),
        (
            words("key_speed"),
            words.number(event["impact_speed_kmh"], 0),
            "km/h",
            words.interval(event["impact_speed_interval95_kmh"], 0),
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
                ("LEFTPADDING", (0, 0), (-1, -1), 8),
                ("TOPPADDING", (0, 0), (-1, 0), 6),
                ("BOTTOMPADDING", (0, 2), (-1, 2), 7),
                ("TOPPADDING", (0, 1), (-1, 2), 0),
            ]
        )
    )
    return table


def _hours(clock: int, words: Words) -> str:
    return f"{clock} {words('oclock')}" if words.language == "en" else f"{words('oclock')} {clock}"


def sentences(document: dict[str, Any], words: Words, at: dt.datetime) -> list[str]:
    """What happened, in words with numbers."""
    event, clock = document["event"], document["inputs"]["clock"]
    number = words.number
    sigma = event["basis"]["utc_sigma_s"] if event["basis"]["utc_sigma_s"] is not None else clock["utc_sigma_s"]
    told = [
        words(
            "s_what",
            kind=words(event["kind"]),
            date=words.date(at.year, at.month, at.day),
            time=clock_time(at, words),
            sigma=number(sigma, 1),
        )
    ]
    if event["pdof_deg"] is not None:
        low, high = event["pdof_interval95_deg"]
        told.append(
            words(
                "s_force",
                where=words(f"where{event['pdof_clock']}"),
                clock=event["pdof_clock"],
                pdof=number(event["pdof_deg"], 0),
                low=number(low, 0),
                high=number(high, 0),
            )
        )
    told += [
        words(key, **{name: number(value, 0)}, low=number(interval[0], 0), high=number(interval[1], 0))
        for key, name, value, interval in (
            ("s_dv", "dv", event["delta_v_kmh"]["resultant"], event["delta_v_interval95_kmh"]["resultant"]),
            ("s_speed", "v", event["impact_speed_kmh"], event["impact_speed_interval95_kmh"]),
            ("s_roll", "angle", event["rollover_angle_deg"], event["rollover_angle_interval95_deg"]),
        )
        if value is not None
    ]
    return told + _aftermath(event, words)


def _aftermath(event: dict[str, Any], words: Words) -> list[str]:
    number, driver, rest = words.number, event["driver"], event["rest"]
    told: list[str] = []
    if driver is not None and driver["braked_from_s"] is not None:
        told.append(words("s_braked", t=number(-driver["braked_from_s"], 1), a=number(driver["braking_mps2"], 1)))
    elif driver is not None:
        told.append(words("s_not_braked"))
    for second in event["second_impacts"]:
        low, high = second["resultant_interval95_kmh"]
        after = number(second["t0_s"] - event["t0_s"], 1)
        told.append(
            words("s_second", t=after, dv=number(second["resultant_kmh"], 0), low=number(low, 0), high=number(high, 0))
        )
    if rest is not None and rest["distance_m"] is not None:
        after, radius = number(rest["t_s"] - event["t0_s"], 1), number(rest["radius95_m"], 1)
        told.append(words("s_rest", t=after, d=number(rest["distance_m"], 0), r=radius))
    if event["clipped"]:
        told.append(words("s_clipped", n=event["clipped_samples"]))
    return told


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
    rest = None if event["rest"] is None else {**event["rest"], "t0_s": event["t0_s"]}
    half = 0.5 * width - 5
    whole = WayMap(way, words, half, 235, title=words("map_all"), span_s=(-30.0, 30.0), rest=rest)
    near = WayMap(way, words, half, 235, title=words("map_near"), span_s=(-3.0, 8.0), rest=rest)
    table = Table([[whole, near]], colWidths=[half + 10, half])
    table.setStyle(TableStyle([("LEFTPADDING", (0, 0), (-1, -1), 0), ("RIGHTPADDING", (0, 0), (-1, -1), 0)]))
    return table, words("map_note", grid=f"{whole.grid:g}; {near.grid:g}")


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
    return [_table([heads, *rows], (0.2,) * 5, width), _pairs(facts, width)]


def numbers_table(event: dict[str, Any], words: Words, width: float) -> Table:
    """Every number with its interval; what is not known is not recorded."""
    rows: list[list[Any]] = [[words(key) for key in ("n_name", "n_value", "n_interval", "n_unit")]]

    def add(
        key: str, value: float | None, interval: list[float] | None, unit: str, digits: int = 1, **names: Any
    ) -> None:
        rows.append([words(key, **names), words.number(value, digits), words.interval(interval, digits), unit])

    if event["pulse"] is None:
        add("n_peak_event", event["peak_g"], None, "g", 2)
        add("n_length", event["t_end_s"] - event["t0_s"], None, "s", 2)
        return _table(rows, (0.46, 0.18, 0.24, 0.12), width)
    pulse, indices = event["pulse"], event["indices"]
    for key, name in (("n_dvx", "longitudinal"), ("n_dvy", "lateral"), ("n_dvr", "resultant")):
        add(key, event["delta_v_kmh"][name], event["delta_v_interval95_kmh"][name], "km/h")
    add("n_tmax", event["time_of_max_ms"], None, "ms")
    add("n_pdof", event["pdof_deg"], event["pdof_interval95_deg"], "°")
    add("n_clock", event["pdof_clock"], None, words("oclock"), 0)
    add("n_speed", event["impact_speed_kmh"], event["impact_speed_interval95_kmh"], "km/h")
    add("n_rebound", event["rebound_kmh"], event["rebound_interval95_kmh"], "km/h")
    add("n_peak", pulse["peak_g"], None, f"g, {words('at_least')}" if pulse["peak_is_lower_bound"] else "g")
    rows.append([words("n_filter"), pulse["filter"], "\N{EN DASH}", ""])
    add("n_mean", pulse["mean_g"], None, "g")
    add("n_duration", pulse["duration_ms"], None, "ms", 0)
    add("n_measured", pulse["measured_delta_v_kmh"], None, "km/h")
    add("n_gps", pulse["gps_delta_v_kmh"], None, "km/h")
    for k, second in enumerate(event["second_impacts"], start=2):
        add("n_second", second["resultant_kmh"], second["resultant_interval95_kmh"], "km/h", k=k)
        add("n_second_pdof", second["pdof_deg"], second["pdof_interval95_deg"], "°", k=k)
    add("n_roll", event["rollover_angle_deg"], event["rollover_angle_interval95_deg"], "°")
    add("n_asi", indices["asi_en1317_2010"], None, "", 2)
    add("n_asi98", indices["asi_en1317_1998"], None, "", 2)
    add("n_olc", indices["olc_g"], None, "g")
    add("n_thiv", indices["thiv_kmh"], None, "km/h")
    add("n_phd", indices["phd_g"], None, "g")
    return _table(rows, (0.46, 0.18, 0.22, 0.14), width)


def risk_table(event: dict[str, Any], words: Words, width: float) -> Table:
    """Probabilities by published curves."""
    rows: list[list[Any]] = [[words(key) for key in ("r_curve", "r_people", "r_level", "r_p", "n_interval")]]
    for risk in event["injuries"]:
        value = next(value for name, value in risk.items() if name.startswith("p_"))
        interval = [100.0 * end for end in risk["interval95"]]
        told = f"{words.number(100.0 * value, 1)} %"
        rows.append([risk["curve"], risk["population"], risk["level"], told, words.interval(interval, 1)])
    return _table(rows, (0.22, 0.42, 0.1, 0.11, 0.15), width)


def basis_table(document: dict[str, Any], words: Words, width: float) -> Table:
    """Rate, full scale, fixes, lag, mounting."""
    event = document["event"]
    basis, number = event["basis"], words.number
    sigma, lag = basis["mounting_sigma_deg"], basis["gps_lag_s"]
    first, last = basis["window_s"]
    rows = [
        (words("q_rate"), f"{number(basis['sample_rate_hz'], 0)} Hz"),
        (
            words("q_scale"),
            words("not_recorded") if basis["full_scale_g"] is None else f"{number(basis['full_scale_g'], 1)} g",
        ),
        (words("q_clip"), str(event["clipped_samples"])),
        (words("q_gyro"), words("yes" if basis["gyro"] else "no")),
        (words("q_fixes"), f"{basis['fixes_before']} / {basis['fixes_after']}"),
        (words("q_lag"), " / ".join(number(lag[name], 2) for name in ("speed", "course")) + " s"),
        (words("q_mount"), words(basis["mounting_status"])),
        (words("q_sigma"), words("not_recorded") if sigma is None else " / ".join(number(s, 2) for s in sigma) + " °"),
        (words("q_window"), f"{number(first, 2)} … {number(last, 2)} s"),
        (words("q_conf"), number(event["confidence"], 2)),
    ]
    return _pairs(rows, width)


def provenance_tables(document: dict[str, Any], event_sha256: str, words: Words, width: float) -> list[Flowable]:
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
        (words("p_clock"), words(how, s=words.number(clock["utc_sigma_s"], 2))),
    ]
    heads: list[Any] = [words(key) for key in ("p_link", "p_stream", "p_span", "p_body", "p_columns")]
    # The batches that hold time zero are never among those left out.
    t0 = document["event"]["t0_s"]
    ranked = sorted(inputs["batches"], key=lambda b: max(b["t_first_s"] - t0, t0 - b["t_last_s"]))
    shown = sorted(ranked[:MAX_LINKS], key=lambda b: b["chain_index"])
    links = [
        [
            str(batch["chain_index"]),
            words(batch["stream"]),
            f"{words.number(batch['t_first_s'], 1)} … {words.number(batch['t_last_s'], 1)}",
            Paragraph(batch["body_sha256"], HASH),
            Paragraph(batch["column_sha256"], HASH),
        ]
        for batch in shown
    ]
    found: list[Flowable] = [_pairs(rows, width), _table([heads, *links], (0.08, 0.12, 0.18, 0.31, 0.31), width)]
    left = len(inputs["batches"]) - len(shown)
    if left:
        found.append(Paragraph(words("link_more", n=left), HEAD))
    return found
