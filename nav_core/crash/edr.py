"""The element table of 49 CFR 563 filled from an event, "not recorded" where a box cannot know.

The shape is that of tables I and II of §563.7; a box on the windscreen is no EDR of the vehicle, and none of this says
that it is.  Signs are those of the regulation's figure: forward and to the right positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.record import CrashEvent, Estimate, Pulse
from nav_core.typing import Floats

KMH = 3.6
DELTA_V_STEP, DELTA_V_LAST = 0.010, 0.250
"""Of the delta-V history, s: 100 Hz, to 250 ms or 30 ms after the end of event."""

MAXIMUM_LAST = 0.300
PRE_CRASH, PRE_CRASH_STEP = 20.0, 0.1
"""Speed is recorded for 20 s at 10 Hz (89 FR 102810), s."""

NOT_VEHICLE = "not recorded: the box is not connected to the vehicle"


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """One row of table I or II of 49 CFR 563.7.

    Attributes
    ----------
    table : {"I", "II"}
    name, unit : str
    times : tuple of float
        From time zero, s; empty for a single value.
    values : tuple of float or str
        In `unit`; empty when not recorded.
    interval : tuple of float, optional
        95 %, of a single number.
    note : str
        How it was got, or why it is not recorded.
    """

    table: str
    name: str
    unit: str
    times: tuple[float, ...] = ()
    values: tuple[float | str, ...] = ()
    interval: tuple[float, float] | None = None
    note: str = ""

    @property
    def recorded(self) -> bool:
        """Whether there is a value."""
        return bool(self.values)


def element_table(event: CrashEvent) -> tuple[Element, ...]:
    """Elements of tables I and II in the order of the regulation.

    Parameters
    ----------
    event : CrashEvent

    Returns
    -------
    tuple of Element
        Every element of both tables; those that a box cannot know are not recorded.
    """
    return (*_table_one(event), *_table_two(event))


def _table_one(event: CrashEvent) -> tuple[Element, ...]:
    delta_v = event.delta_v
    along = None if delta_v is None else delta_v.longitudinal
    return (
        _history("I", "Delta-V, longitudinal", event.pulse if along is not None else None, 0),
        _single("I", "Maximum delta-V, longitudinal", "km/h", _largest(event, 0), KMH),
        _time_of_largest("I", "Time, maximum delta-V, longitudinal", event, 0),
        _speed(event),
        _missing("I", "Engine throttle, % full (or accelerator pedal, % full)", "%"),
        _missing("I", "Service brake, on/off", ""),
        _missing("I", "Ignition cycle, crash", ""),
        _missing("I", "Ignition cycle, download", ""),
        _missing("I", "Safety belt status, driver", ""),
        _missing("I", "Frontal air bag warning lamp, on/off", ""),
        _missing("I", "Frontal air bag deployment, time to deploy, driver", "ms"),
        _missing("I", "Frontal air bag deployment, time to deploy, right front passenger", "ms"),
        _count(event),
        _between(event),
        Element(
            table="I",
            name="Complete file recorded",
            unit="",
            values=("yes" if _complete(event) else "no",),
            note="the pulse from time zero to 30 ms after the end of event, without a gap",
        ),
    )


def _table_two(event: CrashEvent) -> tuple[Element, ...]:
    pulse, delta_v = event.pulse, event.delta_v
    told = delta_v is not None and delta_v.lateral is not None
    held = pulse if told else None
    resultant = None if delta_v is None else delta_v.resultant
    when = () if delta_v is None else (round(1e3 * delta_v.time_of_max, 3),)
    return (
        _acceleration("Lateral acceleration", held, 1),
        _acceleration("Longitudinal acceleration", held, 0),
        _acceleration("Normal acceleration", held, 2),
        _history("II", "Delta-V, lateral", held, 1),
        _single("II", "Maximum delta-V, lateral", "km/h", _largest(event, 1), KMH),
        _time_of_largest("II", "Time, maximum delta-V, lateral", event, 1),
        _single("II", "Maximum delta-V, resultant", "km/h", resultant, KMH),
        Element(
            table="II",
            name="Time, maximum delta-V, resultant",
            unit="ms",
            values=when,
            note="from time zero" if when else "not recorded",
        ),
        _missing("II", "Engine rpm", "rpm"),
        _single("II", "Vehicle roll angle", "deg", event.rollover_angle, 180.0 / np.pi, "not recorded: no rollover"),
        _missing("II", "ABS activity", ""),
        _missing("II", "Stability control", ""),
        _missing("II", "Steering input", "%"),
        _missing("II", "Safety belt status, right front passenger", ""),
        _missing("II", "Frontal air bag suppression switch status, right front passenger", ""),
        _missing("II", "Frontal air bag deployment, time to nth stage, driver", "ms"),
        _missing("II", "Frontal air bag deployment, time to nth stage, right front passenger", "ms"),
        _missing("II", "Frontal air bag deployment, nth stage disposal, driver", ""),
        _missing("II", "Frontal air bag deployment, nth stage disposal, right front passenger", ""),
        _missing("II", "Side air bag deployment, time to deploy, driver", "ms"),
        _missing("II", "Side air bag deployment, time to deploy, right front passenger", "ms"),
        _missing("II", "Side curtain/tube air bag deployment, time to deploy, driver side", "ms"),
        _missing("II", "Side curtain/tube air bag deployment, time to deploy, right side", "ms"),
        _missing("II", "Pretensioner deployment, time to fire, driver", "ms"),
        _missing("II", "Pretensioner deployment, time to fire, right front passenger", "ms"),
        _missing("II", "Seat track position switch, foremost, status, driver", ""),
        _missing("II", "Seat track position switch, foremost, status, right front passenger", ""),
        _missing("II", "Occupant size classification, driver", ""),
        _missing("II", "Occupant size classification, right front passenger", ""),
        _missing("II", "Occupant position classification, driver", ""),
        _missing("II", "Occupant position classification, right front passenger", ""),
    )


def _missing(table: str, name: str, unit: str) -> Element:
    return Element(table=table, name=name, unit=unit, note=NOT_VEHICLE)


def _single(
    table: str, name: str, unit: str, estimate: Estimate | None, scale: float, absent: str = "not recorded"
) -> Element:
    if estimate is None:
        return Element(table=table, name=name, unit=unit, note=absent)
    low, high = scale * estimate.low, scale * estimate.high
    return Element(table=table, name=name, unit=unit, values=(scale * estimate.value,), interval=(low, high))


def _steps(pulse: Pulse, step: float, last: float) -> Floats:
    """Moments from time zero to the shorter of `last` and the end of integration, s."""
    count = int(min(last, float(pulse.t[-1])) / step + 1e-9) + 1
    return step * np.arange(count, dtype=np.float64)


def _history(table: str, name: str, pulse: Pulse | None, axis: int) -> Element:
    if pulse is None:
        return Element(table=table, name=name, unit="km/h", note="not recorded: the mounting is not known")
    t = _steps(pulse, DELTA_V_STEP, DELTA_V_LAST)
    values = KMH * np.interp(t, pulse.t, pulse.delta_v[:, axis])
    note = "100 samples per second, from time zero"
    return Element(table=table, name=name, unit="km/h", times=_plain(t), values=_plain(values), note=note)


def _acceleration(name: str, pulse: Pulse | None, axis: int) -> Element:
    if pulse is None:
        return Element(table="II", name=name, unit="g", note="not recorded: the mounting is not known")
    inside = pulse.t >= 0.0
    values = pulse.recorded[inside, axis] / STANDARD_GRAVITY
    note = f"as recorded, gravity removed; {int(pulse.clipped[inside].sum())} samples at full scale"
    return Element(table="II", name=name, unit="g", times=_plain(pulse.t[inside]), values=_plain(values), note=note)


def _window(pulse: Pulse, axis: int) -> tuple[float, float]:
    """Largest change along one axis within 300 ms, signed, m/s, and when, s."""
    inside = (pulse.t >= 0.0) & (pulse.t <= MAXIMUM_LAST)
    v, t = pulse.delta_v[inside, axis], pulse.t[inside]
    k = int(np.argmax(np.abs(v)))
    return float(v[k]), float(t[k])


def _largest(event: CrashEvent, axis: int) -> Estimate | None:
    """Largest change along one axis; its interval is that of the component at the resultant's maximum, moved."""
    pulse, delta_v = event.pulse, event.delta_v
    if pulse is None or delta_v is None:
        return None
    part = delta_v.longitudinal if axis == 0 else delta_v.lateral
    if part is None:
        return None
    value, _ = _window(pulse, axis)
    return Estimate(value, value - (part.value - part.low), value + (part.high - part.value))


def _time_of_largest(table: str, name: str, event: CrashEvent, axis: int) -> Element:
    if event.pulse is None or _largest(event, axis) is None:
        return Element(table=table, name=name, unit="ms", note="not recorded")
    _, when = _window(event.pulse, axis)
    return Element(table=table, name=name, unit="ms", values=(1e3 * when,), note="from time zero")


def _speed(event: CrashEvent) -> Element:
    name, way = "Speed, vehicle indicated", event.trajectory
    if way is None:
        return Element(table="I", name=name, unit="km/h", note="not recorded: no GPS")
    first = max(-PRE_CRASH, float(way.t[0]))
    t = PRE_CRASH_STEP * np.arange(int(np.ceil(first / PRE_CRASH_STEP - 1e-9)), 1, dtype=np.float64)
    values = np.interp(t, way.t, KMH * way.speed)
    note = "over ground, from GPS and accelerometer, 10 samples per second; not the speedometer's"
    return Element(table="I", name=name, unit="km/h", times=_plain(t), values=_plain(values), note=note)


def _count(event: CrashEvent) -> Element:
    count = 1 + len(event.second_impacts)
    return Element(table="I", name="Multi-event, number of events", unit="", values=(float(count),))


def _between(event: CrashEvent) -> Element:
    name = "Time from event 1 to 2"
    if not event.second_impacts:
        return Element(table="I", name=name, unit="s", note="not recorded: one event")
    first, second, *_ = event.blows
    return Element(table="I", name=name, unit="s", values=(second - first,))


def _complete(event: CrashEvent) -> bool:
    spoiled = {"starts_in_event", "ends_in_event", "gap_in_event"}
    return event.pulse is not None and not spoiled & {remark.code for remark in event.quality}


def _plain(values: Floats) -> tuple[float, ...]:
    return tuple(float(each) for each in values)
