"""What stays below the trigger: side swipes, bumps while parked, vehicles on their side, road shocks."""

from __future__ import annotations

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.finding import OVER, SEVERE, TURNED, Finding
from nav_core.events.record import EventKind, VehicleClass
from nav_core.events.scene import MOVES, STANDS, STILL, Scene, scatter_of
from nav_core.events.signs import Around, core_of, peak_of, signs_of, window_at
from nav_core.events.trigger import (
    AFTER_END,
    FAINTEST,
    MULTI_EVENT,
    THRESHOLD,
    Stream,
    Window,
    groups,
    off_rest,
    sideways_within,
)
from nav_core.records import Remark
from nav_core.signal import first_not_before
from nav_core.typing import Flags

PARKED_CHANGE = FAINTEST
"""Change within 150 ms that makes a bump at standstill, m/s: a door slam stays under a third of it."""

SWIPE_CHANGE = 1.25
"""Change to the side within 100 ms that makes a side swipe below the trigger, m/s: 1.3 g on average, beyond tyres."""

SWIPE_LONGEST = 0.5
"""Longer than this it was a bend, s."""

SHOCK: dict[VehicleClass, float] = {"car": 20.0, "van": 22.0, "truck": 30.0, "bus": 25.0, "motorcycle": 35.0}
"""Force off its surroundings that makes a road shock, m/s²: stiffer vehicles shake harder."""

PARKED_PEAK = 5.0
"""Least force of a bump, m/s²: no vehicle pulls away so hard."""

BUMP_LONGEST = 0.5
"""Longer than this a vehicle was driven, s."""

TYRES = 1.3 * STANDARD_GRAVITY
"""Least force of a further bump of a vehicle that still slides from the one before, m/s²: beyond tyres."""

ROLLS_WITHIN = 4.0
"""A vehicle that turns over does so within this time, s."""

SLIDES = 0.15
"""A further bump is looked for so long after the blow before it, s."""


def _free(stream: Stream, found: list[Finding], apart: float) -> Flags:
    """Samples at least `apart` s away from what is found already."""
    free = np.ones(stream.t.size, dtype=np.bool_)
    for each in found:
        begin, stop = stream.t[each.window.zero] - apart, stream.t[each.window.last] + apart
        first, last = np.searchsorted(stream.t, [begin, stop])
        free[first:last] = False
    return free


def swipes(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Blows to the side below the trigger, of a moving vehicle.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    found : list of Finding
        So far; nothing is found again close to them.

    Returns
    -------
    list of Finding
        Of kind ``crash``, with the remark ``below_trigger``.
    """
    stream = scene.stream
    sideways = (np.abs(sideways_within(stream, 0.1)) >= SWIPE_CHANGE) & _free(stream, found, 1.0)
    out: list[Finding] = []
    for first, last in groups(sideways, stream.t, 0.3):
        window = window_at(scene, core_of(stream, first, last), threshold=THRESHOLD / 2.0)
        signs = signs_of(scene, window)
        moved = signs.before is not None and signs.before > MOVES
        if not moved or signs.fell or signs.turned > TURNED or signs.kept < 0.6:
            continue
        if _off_the_bend(stream, window) < SWIPE_CHANGE:
            continue
        remark = Remark("below_trigger", "A blow to the side below the trigger of 49 CFR 563.")
        out.append(Finding("crash", window, 0.7, peak_of(stream, window), (remark,)))
    return out


def _off_the_bend(stream: Stream, window: Window) -> float:
    """Sideways change of a short event without what cornering before and after it explains, m/s; 0 of a long one."""
    t0, t_end = float(stream.t[window.zero]), float(stream.t[window.end])
    if t_end - t0 > SWIPE_LONGEST:
        return 0.0
    around = [stream.mean(t0 - 0.3, t0 - 0.02), stream.mean(t_end + 0.02, t_end + 0.3)]
    bend = [float(mean[1] - stream.rest[window.zero, 1]) for mean in around if mean is not None]
    change = float(stream.at(np.array([t_end]))[0, 1] - stream.v[window.zero, 1])
    # The rest is taken anew at each sample: over so short an event it stays what it was.
    return abs(change - (float(np.mean(bend)) if bend else 0.0) * (t_end - t0))


def bumps(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Bumps of a parked vehicle, below the trigger.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    found : list of Finding
        So far; nothing is found again close to them.

    Returns
    -------
    list of Finding
        Of kind ``parked_impact``, or ``handling`` where the box lies differently afterwards.
    """
    stream = scene.stream
    out: list[Finding] = []
    loud = (stream.strongest >= PARKED_CHANGE) & _free(stream, found, 1.0)
    for first, last in groups(loud, stream.t, 0.5):
        if not scene.stands_before(float(stream.t[first]) - 0.1):
            continue
        window = window_at(scene, core_of(stream, first, last), threshold=THRESHOLD / 4.0)
        signs = signs_of(scene, window)
        if signs.fell or signs.turned > TURNED:
            remark = Remark("box_turned", "The box was moved while its vehicle stood.")
            out.append(Finding("handling", window, 0.9, peak_of(stream, window), (remark,)))
        elif _bump(stream, window) and _stays(scene, window):
            out.append(Finding("parked_impact", window, 0.8, peak_of(stream, window)))
    return out + _further(scene, [*found, *out])


def _further(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Further bumps of a vehicle that stood when it was first struck, within the five seconds of one event."""
    stream = scene.stream
    t = stream.t
    struck = [each for each in found if each.kind in SEVERE and scene.stands_before(float(t[each.window.zero]) - 1.0)]
    if not struck:
        return []
    hard = np.linalg.norm((stream.f - stream.rest)[:, :2], axis=1) >= TYRES
    out: list[Finding] = []
    for one in struck:
        zero = one.window.zero
        first, last = np.searchsorted(stream.t, [stream.t[zero] - MULTI_EVENT, stream.t[zero] + MULTI_EVENT])
        near = np.zeros(stream.t.size, dtype=np.bool_)
        near[first:last] = True
        for begin, end in groups(hard & near & _free(stream, [*found, *out], SLIDES), stream.t, 0.1):
            window = window_at(scene, core_of(stream, begin, end))
            at = float(stream.t[window.zero])
            signs = signs_of(scene, window, Around(min(at, float(stream.t[zero])), np.inf, alone=False))
            if _bump(stream, window) and not (signs.fell or signs.turned > TURNED):
                out.append(Finding("parked_impact", window, 0.7, peak_of(stream, window)))
    return out


def _stays(scene: Scene, window: Window) -> bool:
    """Whether the vehicle stood quietly before and stands again soon, as far as recorded: it did not just pull away."""
    stream = scene.stream
    t0, t_end = float(stream.t[window.zero]), float(stream.t[window.end])
    if scene.brakes_before(t0):
        return False
    before, after = scatter_of(stream, t0 - 2.1, t0 - 0.05), scatter_of(stream, t_end + 2.0, t_end + 4.0)
    if max(before or 0.0, after or 0.0) > 2.0 * STILL:
        return False
    speed = scene.speed_after(t_end + 1.0)
    return speed is None or speed < STANDS


def _bump(stream: Stream, window: Window) -> bool:
    """Whether a whole vehicle was moved: by a push of one direction and some length, level, not a jolt of the box."""
    part = slice(window.zero, window.last + 1)
    a = stream.f[part] - stream.rest[window.zero]
    v = np.cumsum(a * stream.step[part, None], axis=0)
    size = np.hypot(v[:, 0], v[:, 1])
    length = float(stream.t[window.end] - stream.t[window.zero])
    level = size.max() > 1.5 * np.abs(v[:, 2]).max()
    force = np.hypot(a[:, 0], a[:, 1])
    one_way = size.max() > 0.45 * float((force * stream.step[part]).sum())
    hard = size.max() >= PARKED_CHANGE and force.max() >= PARKED_PEAK
    return bool(hard and level and one_way and 0.035 <= length <= BUMP_LONGEST)


def tilted(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Vehicles that came to lie on a side, and boxes that were turned while the vehicle stood, without any blow.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    found : list of Finding
        So far; a tilt within five seconds of one belongs to it.

    Returns
    -------
    list of Finding
        Of kind ``rollover`` or ``handling``; none in a recording shorter than 4 s.
    """
    stream = scene.stream
    span = float(stream.t[-1] - stream.t[0])
    if span < 4.0:
        return []
    cell = np.floor((stream.t - stream.t[0]) / 0.5)  # those that hold samples: a clock may jump by years
    edges = np.concatenate([[0], np.flatnonzero(np.diff(cell)) + 1, [stream.t.size]])
    full = np.flatnonzero(np.diff(edges) > 2)
    if full.size == 0:
        return []
    means = np.add.reduceat(stream.f, edges[:-1], axis=0)[full] / np.diff(edges)[full, None]
    size = np.linalg.norm(means, axis=1)
    usual = np.median(means, axis=0)
    lean = np.arccos(np.clip(means @ usual / np.maximum(size * np.linalg.norm(usual), 1e-9), -1.0, 1.0))
    at = stream.t[edges[full]]
    over = (lean > OVER) & (np.abs(size - STANDARD_GRAVITY) < 0.4 * STANDARD_GRAVITY)
    out: list[Finding] = []
    for first, last in groups(over, at, 1.5):
        t = float(at[first])
        near = any(abs(float(stream.t[each.window.zero]) - t) < MULTI_EVENT for each in found)
        if at[last] - at[first] < 1.0 or near:
            continue
        k = int(edges[full[first]])
        window = _window_from(stream, k, min(int(np.searchsorted(stream.t, stream.t[k] + 0.5)), stream.t.size - 1))
        down = means[first : last + 1].mean(axis=0)
        later = scene.speed_after(t + 8.0)
        rolled = scene.drove_before(t - 1.0, by_force=False) and abs(down[0]) < 0.4 * STANDARD_GRAVITY
        rolled = rolled and (later is None or later < MOVES)  # on its side no vehicle drives on
        kind: EventKind = "rollover" if rolled else "handling"
        remark = Remark("lies_differently", f"The box leans by {np.degrees(lean[first : last + 1].max()):.0f}°.")
        out.append(Finding(kind, window, 0.8, peak_of(stream, window), (remark,)))
    return out + _turned_over(scene, [*found, *out])


def _window_from(stream: Stream, zero: int, end: int) -> Window:
    """Window of what has no pulse to be read from."""
    return Window(zero, end, min(int(np.searchsorted(stream.t, stream.t[end] + AFTER_END)), stream.t.size - 1))


def _turned_over(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Vehicles that turned over by the gyro, softly, and may lie upright again."""
    stream = scene.stream
    if scene.w is None:
        return []
    rate = np.nan_to_num(scene.w[:, 0])
    roll = np.cumsum((rate - np.median(rate)) * stream.step)
    later = np.minimum(first_not_before(stream.t, stream.t + ROLLS_WITHIN), stream.t.size - 1)
    out: list[Finding] = []
    for first, last in groups(np.abs(roll[later] - roll) > OVER, stream.t, ROLLS_WITHIN):
        # It begins where it has turned by a tenth of what it does.
        until = int(later[last])
        turned = np.abs(roll[first : until + 1] - roll[first])
        begin = first + int(np.argmax(turned > 0.1 * turned.max()))
        at = float(stream.t[begin])
        if any(abs(float(stream.t[each.window.zero]) - at) < MULTI_EVENT for each in found if each.kind in SEVERE):
            continue
        window = _window_from(stream, begin, until)
        signs = signs_of(scene, window)
        drove_on = signs.shaken if signs.later is None else signs.later > MOVES
        drove = scene.drove_before(at - 0.5, by_force=False)
        if drove and signs.rolled > OVER and not drove_on:
            remark = Remark("turned_over", f"By the gyro the vehicle turned over by {np.degrees(signs.rolled):.0f}°.")
            out.append(Finding("rollover", window, 0.8, peak_of(stream, window), (remark,)))
    return out


def shocks(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Short hard shocks while moving: potholes, kerbs.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    found : list of Finding
        So far; nothing is found again close to them.

    Returns
    -------
    list of Finding
        Of kind ``road_shock``.
    """
    stream = scene.stream
    off = off_rest(stream)
    hard = (off >= SHOCK[scene.vehicle_class]) & _free(stream, found, 1.0)
    out: list[Finding] = []
    for first, last in groups(hard, stream.t, 1.0):
        if scene.stands_before(float(stream.t[first]) - 0.1):
            continue
        window = Window(first, last, last)
        out.append(Finding("road_shock", window, 0.8, float(off[first : last + 1].max())))
    return out
