"""An event's numbers and sentences in words, for the report and the page alike."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Any, cast

from server.events.exports import utc_sigma_s
from server.reports.words import Words

Row = tuple[str, str, str, str]
"""Name, value, 95 % interval, unit."""


def clock_time(at: dt.datetime, words: Words) -> str:
    """Time of day with hundredths."""
    text = at.strftime("%H:%M:%S.%f")[:-4]
    return text if words.language == "en" else text.replace(".", ",")


def hours(clock: int, words: Words) -> str:
    return f"{clock} {words('oclock')}" if words.language == "en" else f"{words('oclock')} {clock}"


def in_unit(told: Any, per_kmh: float) -> Any:
    """The crash JSON with every speed of a member `..._kmh` in another unit; names stay."""
    if isinstance(told, Mapping):
        members = cast("Mapping[str, Any]", told)
        return {
            name: _scaled(value, per_kmh) if name.endswith("_kmh") else in_unit(value, per_kmh)
            for name, value in members.items()
        }
    return [in_unit(one, per_kmh) for one in cast("list[Any]", told)] if isinstance(told, list) else told


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, Mapping):
        return {name: _scaled(part, factor) for name, part in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, list):
        return [_scaled(part, factor) for part in cast("list[Any]", value)]
    return None if value is None else factor * value


def sentences(document: dict[str, Any], words: Words, at: dt.datetime) -> list[str]:
    """What happened, in words with numbers."""
    event, number = document["event"], words.number
    told = [
        words(
            "s_what",
            kind=words(event["kind"]),
            date=words.date(at.year, at.month, at.day),
            time=clock_time(at, words),
            sigma=words.spread(utc_sigma_s(document)),
        )
    ]
    if event["pdof_deg"] is not None:
        low, high = event["pdof_interval95_deg"]
        told.append(
            words(
                "s_force",
                where=words(f"where{event['pdof_clock']}"),
                clock=event["pdof_clock"],
                pdof=number(event["pdof_deg"], 1),
                low=number(low, 1),
                high=number(high, 1),
            )
        )
    told += [
        words(key, **{name: number(value, 1)}, low=number(interval[0], 1), high=number(interval[1], 1))
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
        apart = second["t0_s"] - event["t0_s"]
        told.append(
            words(
                "s_second" if apart > 0.0 else "s_earlier",
                t=number(abs(apart), 1),
                dv=number(second["resultant_kmh"], 1),
                low=number(low, 1),
                high=number(high, 1),
            )
        )
    if rest is not None and rest["distance_m"] is not None:
        after, radius = number(rest["t_s"] - event["t0_s"], 1), number(rest["radius95_m"], 1)
        told.append(words("s_rest", t=after, d=number(rest["distance_m"], 0), r=radius))
    if event["clipped"]:
        told.append(words("s_clipped", n=event["clipped_samples"]))
    return told


def number_rows(event: dict[str, Any], words: Words) -> list[Row]:
    """Every number with its interval; what is not known is not recorded."""
    rows: list[Row] = []

    def add(
        key: str, value: float | None, interval: list[float] | None, unit: str, digits: int = 1, **names: Any
    ) -> None:
        rows.append((words(key, **names), words.number(value, digits), words.interval(interval, digits), unit))

    if event["pulse"] is None:
        add("n_peak_event", event["peak_g"], None, "g", 2)
        add("n_length", event["t_end_s"] - event["t0_s"], None, "s", 2)
        return rows
    pulse, indices = event["pulse"], event["indices"]
    for key, name in (("n_dvx", "longitudinal"), ("n_dvy", "lateral"), ("n_dvr", "resultant")):
        add(key, event["delta_v_kmh"][name], event["delta_v_interval95_kmh"][name], words.speed)
    add("n_tmax", event["time_of_max_ms"], None, "ms")
    add("n_pdof", event["pdof_deg"], event["pdof_interval95_deg"], "°")
    add("n_clock", event["pdof_clock"], None, words("oclock"), 0)
    add("n_speed", event["impact_speed_kmh"], event["impact_speed_interval95_kmh"], words.speed)
    add("n_rebound", event["rebound_kmh"], event["rebound_interval95_kmh"], words.speed)
    add("n_peak", pulse["peak_g"], None, f"g, {words('at_least')}" if pulse["peak_is_lower_bound"] else "g")
    rows.append((words("n_filter"), words.peak_filter(pulse["filter"]), "\N{EN DASH}", ""))
    add("n_mean", pulse["mean_g"], None, "g")
    add("n_duration", pulse["duration_ms"], None, "ms", 0)
    add("n_measured", pulse["measured_delta_v_kmh"], None, words.speed)
    add("n_gps", pulse["gps_delta_v_kmh"], None, words.speed)
    # Numbered in order of time; the strongest, whose numbers stand above, keeps its own.
    times = sorted([event["t0_s"], *(second["t0_s"] for second in event["second_impacts"])])
    for second in event["second_impacts"]:
        k = times.index(second["t0_s"]) + 1
        add("n_second", second["resultant_kmh"], second["resultant_interval95_kmh"], words.speed, k=k)
        add("n_second_pdof", second["pdof_deg"], second["pdof_interval95_deg"], "°", k=k)
    add("n_roll", event["rollover_angle_deg"], event["rollover_angle_interval95_deg"], "°")
    add("n_asi", indices["asi_en1317_2010"], None, "", 2)
    add("n_asi98", indices["asi_en1317_1998"], None, "", 2)
    add("n_olc", indices["olc_g"], None, "g")
    add("n_thiv", indices["thiv_kmh"], None, words.speed)
    add("n_phd", indices["phd_g"], None, "g")
    return rows


def risk_rows(event: dict[str, Any], words: Words) -> list[tuple[str, str, str, str, str]]:
    """Probabilities by published curves."""
    rows: list[tuple[str, str, str, str, str]] = []
    for risk in event["injuries"]:
        value = next(value for name, value in risk.items() if name.startswith("p_"))
        interval = [100.0 * end for end in risk["interval95"]]
        told = f"{words.number(100.0 * value, 1)} %"
        whom, level = words.risk(risk["population"]), words.risk(risk["level"])
        rows.append((risk["curve"], whom, level, told, words.interval(interval, 1)))
    return rows


def _lags(speed: float | None, course: float | None, words: Words) -> str:
    if speed is None and course is None:
        return words("not_recorded")
    return f"{words.number(speed, 2)} / {words.number(course, 2)} s"


def basis_rows(document: dict[str, Any], words: Words) -> list[tuple[str, str]]:
    """Rate, full scale, fixes, lag, mounting."""
    event = document["event"]
    basis, number = event["basis"], words.number
    sigma, lag = basis["mounting_sigma_deg"], basis["gps_lag_s"]
    first, last = basis["window_s"]
    return [
        (words("q_rate"), f"{number(basis['sample_rate_hz'], 0)} Hz"),
        (
            words("q_scale"),
            words("not_recorded") if basis["full_scale_g"] is None else f"{number(basis['full_scale_g'], 1)} g",
        ),
        (words("q_clip"), str(event["clipped_samples"])),
        (words("q_gyro"), words("yes" if basis["gyro"] else "no")),
        (words("q_fixes"), f"{basis['fixes_before']} / {basis['fixes_after']}"),
        (words("q_lag"), _lags(lag["speed"], lag["course"], words)),
        (words("q_mount"), words(basis["mounting_status"])),
        (words("q_sigma"), words("not_recorded") if sigma is None else " / ".join(number(s, 2) for s in sigma) + " °"),
        (words("q_window"), f"{number(first, 2)} … {number(last, 2)} s"),
        (words("q_conf"), number(event["confidence"], 2)),
    ]
