"""What an event was, from physics: does the change of velocity last, does GPS see it, does the box still lie as before.

A pothole gives back what it takes; a dropped box falls freely first and lies differently afterwards; a door slam
happens at standstill and is over in a vibration; braking, however hard, changes velocity too slowly for the trigger.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.record import EventKind, VehicleClass
from nav_core.events.trigger import (
    MULTI_EVENT,
    THRESHOLD,
    TRIGGER,
    Stream,
    Window,
    change_within,
    groups,
    strongest_change,
    window_around,
)
from nav_core.records import Gnss, Remark
from nav_core.typing import Flags, Floats

PARKED_CHANGE = 0.45
"""Change within 150 ms that makes a bump at standstill, m/s: a door slam stays under a third of it."""

SWIPE_CHANGE = 1.25
"""Change to the side within 100 ms that makes a side swipe below the trigger, m/s: 1.3 g on average, beyond tyres."""

SWIPE_LONGEST = 0.5
"""Longer than this it was a bend, s."""

SHOCK: dict[VehicleClass, float] = {"car": 20.0, "van": 22.0, "truck": 30.0, "bus": 25.0, "motorcycle": 35.0}
"""Force off its surroundings that makes a road shock, m/s²: stiffer vehicles shake harder."""

STANDS, MOVES = 0.8, 2.0
"""Below and above these speeds a vehicle stands and moves for certain, m/s."""

FALLING, FALL_TIME = 0.4 * STANDARD_GRAVITY, 0.08
"""A box whose force stays under this for so long falls, m/s² and s; no road does that for so long."""

TURNED = np.radians(20.0)
"""A box that lies differently by so much was handled, or its vehicle lies on its side, rad."""

OVER = np.radians(55.0)
"""A vehicle that leans by so much has rolled over, rad."""

LASTS = 0.35
"""A blow keeps at least this share of its change 0.25 s later."""

CARRIED = 1.2
"""Scatter of the force within a second at standstill of a box that is carried about, m/s²: no engine idles so."""

PARKED_PEAK = 5.0
"""Least force of a bump, m/s²: no vehicle pulls away so hard."""

STILL = 0.16
"""Scatter of the force within 0.2 s at standstill, m/s², with the engine running."""


class Finding(NamedTuple):
    """An event found.

    Attributes
    ----------
    kind : EventKind
    window : Window
    confidence : float
        0..1.
    peak : float
        Largest force off its surroundings, m/s².
    remarks : tuple of Remark
    """

    kind: EventKind
    window: Window
    confidence: float
    peak: float
    remarks: tuple[Remark, ...] = ()


class Scene(NamedTuple):
    """What classification looks at: the stream, when fixes describe what speed, the vehicle's class.

    Attributes
    ----------
    stream : Stream
    fix_t, fix_speed : ndarray, shape (k,)
        Moments that the fixes describe (the lag taken off), s, and their speed, m/s.
    lag_sigma : float
        s.
    vehicle_class : VehicleClass
    upright : bool
        The stream is in V axes or levelled: z is down.
    """

    stream: Stream
    fix_t: Floats
    fix_speed: Floats
    lag_sigma: float
    vehicle_class: VehicleClass

    def speed_before(self, t: float) -> float | None:
        """Speed of the last fix before `t`, at most 5 s old, m/s.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        float or None
            m/s; None where there is no such fix.
        """
        k = int(np.searchsorted(self.fix_t, t - 2.0 * self.lag_sigma)) - 1
        return float(self.fix_speed[k]) if k >= 0 and t - self.fix_t[k] < 5.0 else None

    def speed_after(self, t: float) -> float | None:
        """Speed of the first fix well after `t`, at most 3 s later, m/s.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        float or None
            m/s; None where there is no such fix.
        """
        k = int(np.searchsorted(self.fix_t, t + 0.1 + 2.0 * self.lag_sigma))
        return float(self.fix_speed[k]) if k < self.fix_t.size and self.fix_t[k] - t < 3.0 else None

    def stands_before(self, t: float) -> bool:
        """Whether the vehicle stood before `t`: by the fixes, else by a force that is quiet.

        Parameters
        ----------
        t : float
            Box clock, s.

        Returns
        -------
        bool
            False also where nothing tells.
        """
        speed, earlier = self.speed_before(t), self.speed_before(t - 2.0)
        if speed is not None:
            return speed < STANDS and (earlier is None or earlier < STANDS)
        scatter = _scatter(self.stream, t - 2.0, t - 0.1)
        return scatter is not None and scatter < STILL


def scene_of(
    stream: Stream, gnss: Gnss | None, speed_lag: float, lag_sigma: float, vehicle_class: VehicleClass
) -> Scene:
    """Scene of a recording.

    Parameters
    ----------
    stream : Stream
        Specific force in V axes, m/s².
    gnss : Gnss or None
        None without fixes.
    speed_lag : float
        Of the receiver, s.
    lag_sigma : float
        Its 1-sigma, s.
    vehicle_class : VehicleClass
        Car or heavier.

    Returns
    -------
    Scene
        Fixes at their own moments.
    """
    none = np.zeros(0)
    fix_t, fix_speed = (none, none) if gnss is None else (gnss.t - speed_lag, gnss.speed)
    return Scene(stream, fix_t, fix_speed, min(lag_sigma, 0.2), vehicle_class)


def _scatter(stream: Stream, begin: float, end: float) -> float | None:
    """Usual scatter of the force within fifths of a second, each axis, m/s²; None of less than a second."""
    first, last = np.searchsorted(stream.t, [begin, end])
    if last - first < 8 or stream.t[last - 1] - stream.t[first] < 1.0:
        return None
    step = float(np.median(np.diff(stream.t[first:last])))
    width = max(round(0.2 / step), 2)
    part = stream.f[first:last]
    rows = part[: part.shape[0] // width * width].reshape(-1, width, 3)
    return float(np.median(rows.std(axis=1)))


def _restless(stream: Stream, begin: float, end: float) -> float:
    """Scatter of the force about its mean, all axes, m/s²; 0 without samples."""
    first, last = np.searchsorted(stream.t, [begin, end])
    return float(np.linalg.norm(stream.f[first:last].std(axis=0))) if last - first > 4 else 0.0


def find(scene: Scene) -> list[Finding]:
    """Crashes, rollovers, bumps, shocks and handling of a recording, in order of time; harsh driving is elsewhere.

    Parameters
    ----------
    scene : Scene
        A recording.

    Returns
    -------
    list of Finding
        Each with its window, indices into the scene's stream.
    """
    stream = scene.stream
    if stream.t.size < 4:
        return []
    violent = strongest_change(stream)
    found = [_judged(scene, first, last) for first, last in groups(violent >= TRIGGER, stream.t, 0.3)]
    found += _swipes(scene, found)
    found += _bumps(scene, violent, found)
    found += _tilted(scene, found)
    found += _shocks(scene, found)
    return sorted(found, key=lambda each: each.window.zero)


def _core(stream: Stream, first: int, last: int) -> int:
    """The sample in a run of triggers from which the next 20 ms change most."""
    stop = int(np.searchsorted(stream.t, stream.t[last] + 0.15, side="right"))
    part = Stream(*(column[first:stop] for column in stream))
    return first + int(np.argmax(change_within(part, 0.020)))


def _window(stream: Stream, core: int, *, threshold: float = THRESHOLD) -> Window:
    """Window of the event around a core, looked for within two seconds of it."""
    begin, stop = np.searchsorted(stream.t, [stream.t[core] - 1.5, stream.t[core] + 2.0])
    part = slice(int(begin), int(stop))
    inside = window_around(stream.t[part], stream.v[part, :2], core - int(begin), threshold=threshold)
    return Window(*(each + int(begin) for each in inside))


def peak_of(stream: Stream, window: Window) -> float:
    """Largest force off its surroundings, m/s².

    Parameters
    ----------
    stream : Stream
        Specific force in V axes, m/s².
    window : Window
        Indices into it.

    Returns
    -------
    float
        m/s².
    """
    part = slice(window.zero, window.last + 1)
    return float(np.linalg.norm(stream.f[part] - stream.rest[window.zero], axis=1).max())


class Signs(NamedTuple):
    """What an event looks like."""

    change: float
    """Largest horizontal change of velocity, m/s."""
    kept: float
    """Share of it that is left a quarter of a second later."""
    fell: bool
    """Freely, before it or between its bounces; not told of a recording without gravity."""
    turned: float
    """How much the box lies differently afterwards, rad; 0 when not known."""
    down_after: Floats | None
    """Specific force afterwards, V axes, m/s²."""
    before: float | None
    after: float | None
    later: float | None
    """Speed by GPS just before, just after and eight seconds later, m/s."""


def signs_of(scene: Scene, window: Window) -> Signs:
    """Look at an event.

    Parameters
    ----------
    scene : Scene
        A recording.
    window : Window
        Indices into its stream.

    Returns
    -------
    Signs
        Changes of velocity, m/s, forces, m/s², angles, rad, and speeds before and after, m/s.
    """
    stream, (zero, end, last) = scene.stream, window
    t0, t_end = float(stream.t[zero]), float(stream.t[end])
    rest = stream.rest[zero]
    stop = int(np.searchsorted(stream.t, t_end + 0.25, side="right"))
    a = stream.f[zero:stop] - rest
    v = np.cumsum(a[:, :2] * stream.step[zero:stop, None], axis=0)
    size = np.hypot(*v.T)
    change = float(size[: last + 1 - zero].max())
    before = stream.mean(t0 - 2.5, t0 - 0.1)
    down = _calm_after(stream, t_end)
    turned = 0.0
    if before is not None and down is not None:
        cosine = float(before @ down / max(np.linalg.norm(before) * np.linalg.norm(down), 1e-9))
        turned = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return Signs(
        change=change,
        kept=float(size[-1] / max(change, 1e-9)),
        fell=float(np.linalg.norm(rest)) > 1.5 * FALLING and _fell(stream, t0, t_end),
        turned=turned,
        down_after=down,
        before=scene.speed_before(t0),
        after=scene.speed_after(t_end),
        later=scene.speed_after(t_end + 8.0),
    )


def _calm_after(stream: Stream, t: float) -> Floats | None:
    """Mean force of the first calm second from one to twelve seconds later; None without one.

    Calm is what gravity alone would be: a vehicle that slides or is still handled is not.
    """
    for begin in np.arange(t + 1.0, t + 11.0, 0.5).tolist():
        first, last = np.searchsorted(stream.t, [begin, begin + 1.0])
        if last - first < 4 or stream.t[last - 1] - stream.t[first] < 0.8:
            continue
        part = stream.f[first:last]
        mean = part.mean(axis=0)
        calm = np.linalg.norm(part.std(axis=0)) < 1.0 and abs(np.linalg.norm(mean) - STANDARD_GRAVITY) < 0.4
        if calm:
            return mean
    return None


def _fell(stream: Stream, t0: float, t_end: float) -> bool:
    """Whether the box fell freely before the blow or between its bounces."""
    first, last = np.searchsorted(stream.t, [t0 - 0.7, t_end + 0.3])
    free = np.linalg.norm(stream.f[first:last], axis=1) < FALLING
    t = stream.t[first:last]
    runs = groups(free, t, 0.012)
    return any(t[end] - t[begin] >= FALL_TIME for begin, end in runs)


def _judged(scene: Scene, first: int, last: int) -> Finding:
    """What a run that meets the trigger was."""
    stream = scene.stream
    window = _window(stream, _core(stream, first, last))
    signs = signs_of(scene, window)
    t0 = float(stream.t[window.zero])
    stood = scene.stands_before(t0)
    if stood and _restless(stream, t0 - 1.2, t0 - 0.1) > CARRIED:
        remark = Remark("shaken_before", "The box was moved about before the shock while its vehicle stood.")
        return Finding("handling", window, 0.85, peak_of(stream, window), (remark,))
    kind, confidence, remarks = _verdict(signs, stood)
    return Finding(kind, window, confidence, peak_of(stream, window), remarks)


Verdict = tuple[EventKind, float, tuple[Remark, ...]]


def _verdict(signs: Signs, stood: bool) -> Verdict:
    moved = signs.before is not None and signs.before > MOVES
    drove_on = signs.later is not None and signs.later > MOVES
    harmless = _harmless(signs, stood, moved, drove_on)
    if harmless is not None:
        return harmless
    if _on_its_side(signs) and moved and not drove_on:
        return "rollover", 0.9, ()
    remarks: tuple[Remark, ...] = ()
    if signs.turned > TURNED:
        degrees = float(np.degrees(signs.turned))
        remarks = (Remark("box_turned", f"The box lies {degrees:.0f}° differently after it."),)
    certain = 0.99 if _unaffected(signs) is False or signs.change > 1.5 * TRIGGER else 0.9
    return "crash", certain, remarks


def _harmless(signs: Signs, stood: bool, moved: bool, drove_on: bool) -> Verdict | None:
    """Why what met the trigger was no blow to the vehicle; None when it was one."""
    unaffected = _unaffected(signs)
    if signs.fell and (drove_on or not (moved and unaffected is False)):
        return "handling", 0.95, (Remark("free_fall", "The box fell freely before the shock."),)
    if moved and unaffected:
        kind: EventKind = "handling" if signs.turned > TURNED else "road_shock"
        return kind, 0.9, (Remark("speed_unchanged", "The vehicle's speed by GPS shows no lasting change."),)
    if signs.turned > TURNED and not moved and (stood or signs.before is not None):
        return "handling", 0.9, (Remark("box_turned", "The box lies differently after it, of a vehicle that stood."),)
    if signs.kept < LASTS and unaffected is not False:
        kind = "handling" if stood else "road_shock"
        return kind, 0.8, (Remark("not_lasting", "The change of velocity was given back within a quarter second."),)
    if drove_on and signs.turned > TURNED and not _slowed(signs):
        return "handling", 0.8, (Remark("drove_on", "The box lies differently after it, and the vehicle drove on."),)
    return None


def _unaffected(signs: Signs) -> bool | None:
    """Whether GPS contradicts the change; None where it cannot tell.

    A blow from the side or a push from behind may leave the speed alone or raise it: only a blow much larger than what
    GPS can hide is contradicted, and only where the speed stays the same to a fraction of it.
    """
    if signs.before is None or signs.after is None:
        return None
    seen = abs(signs.after - signs.before)
    if seen > max(0.35 * signs.change, 1.0):
        return False
    # Across the way a change v turns the course and adds v²/(2 speed): not seen in the speed.
    return None if signs.kept >= LASTS else seen < max(0.2 * signs.change, 0.8)


def _slowed(signs: Signs) -> bool:
    """Whether the fixes show most of the change as a change of speed."""
    if signs.before is None or signs.after is None:
        return False
    return abs(signs.after - signs.before) > 0.6 * signs.change


def _on_its_side(signs: Signs) -> bool:
    down = signs.down_after
    if down is None or signs.turned < OVER:
        return False
    # Over its side a vehicle ends without pitch; a box that came loose ends anyhow.
    return bool(abs(down[0]) < 0.4 * STANDARD_GRAVITY and -down[2] < np.cos(OVER) * np.linalg.norm(down))


def _free(stream: Stream, found: list[Finding], apart: float) -> Flags:
    """Samples at least `apart` s away from what is found already."""
    free = np.ones(stream.t.size, dtype=np.bool_)
    for each in found:
        begin, stop = stream.t[each.window.zero] - apart, stream.t[each.window.last] + apart
        first, last = np.searchsorted(stream.t, [begin, stop])
        free[first:last] = False
    return free


def _swipes(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Blows to the side below the trigger, of a moving vehicle."""
    stream = scene.stream
    j = np.minimum(np.searchsorted(stream.t, stream.t + 0.1), stream.t.size - 1)
    sideways = (np.abs(stream.v[j, 1] - stream.v[:, 1]) >= SWIPE_CHANGE) & _free(stream, found, 1.0)
    out: list[Finding] = []
    for first, last in groups(sideways, stream.t, 0.3):
        window = _window(stream, _core(stream, first, last), threshold=THRESHOLD / 2.0)
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


def _bumps(scene: Scene, violent: Floats, found: list[Finding]) -> list[Finding]:
    """Bumps of a parked vehicle, below the trigger."""
    stream = scene.stream
    out: list[Finding] = []
    loud = (violent >= PARKED_CHANGE) & _free(stream, found, 1.0)
    for first, last in groups(loud, stream.t, 0.5):
        if not scene.stands_before(float(stream.t[first]) - 0.1):
            continue
        window = _window(stream, _core(stream, first, last), threshold=THRESHOLD / 4.0)
        signs = signs_of(scene, window)
        if signs.fell or signs.turned > TURNED:
            remark = Remark("box_turned", "The box was moved while its vehicle stood.")
            out.append(Finding("handling", window, 0.9, peak_of(stream, window), (remark,)))
        elif _bump(stream, window) and _stays(scene, window):
            out.append(Finding("parked_impact", window, 0.8, peak_of(stream, window)))
    return out


def _stays(scene: Scene, window: Window) -> bool:
    """Whether the vehicle stood quietly before and stands again soon, as far as recorded: it did not just pull away."""
    stream = scene.stream
    t0, t_end = float(stream.t[window.zero]), float(stream.t[window.end])
    before, after = _scatter(stream, t0 - 2.1, t0 - 0.05), _scatter(stream, t_end + 2.0, t_end + 4.0)
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
    return bool(hard and level and one_way and length >= 0.035)


def _tilted(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Vehicles that came to lie on a side, and boxes that were turned while the vehicle stood, without any blow."""
    stream = scene.stream
    span = float(stream.t[-1] - stream.t[0])
    if span < 4.0:
        return []
    cell = np.floor((stream.t - stream.t[0]) / 0.5)  # those that hold samples: a clock may jump by years
    edges = np.concatenate([[0], np.flatnonzero(np.diff(cell)) + 1, [stream.t.size]])
    full = np.flatnonzero(np.diff(edges) > 2)
    means = np.array([stream.f[edges[k] : edges[k + 1]].mean(axis=0) for k in full])
    if means.size == 0:
        return []
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
        soon = min(int(np.searchsorted(stream.t, stream.t[k] + 0.5)), stream.t.size - 1)
        window = Window(k, soon, soon)
        speed = scene.speed_before(t - 1.0)
        down = means[first : last + 1].mean(axis=0)
        later = scene.speed_after(t + 8.0)
        rolled = speed is not None and speed > MOVES and abs(down[0]) < 0.4 * STANDARD_GRAVITY
        rolled = rolled and (later is None or later < MOVES)  # on its side no vehicle drives on
        kind: EventKind = "rollover" if rolled else "handling"
        remark = Remark("lies_differently", f"The box leans by {np.degrees(lean[first : last + 1].max()):.0f}°.")
        out.append(Finding(kind, window, 0.8, peak_of(stream, window), (remark,)))
    return out


def _shocks(scene: Scene, found: list[Finding]) -> list[Finding]:
    """Short hard shocks while moving: potholes, kerbs."""
    stream = scene.stream
    off = np.linalg.norm(stream.f - stream.rest, axis=1)
    hard = (off >= SHOCK[scene.vehicle_class]) & _free(stream, found, 1.0)
    out: list[Finding] = []
    for first, last in groups(hard, stream.t, 1.0):
        if scene.stands_before(float(stream.t[first]) - 0.1):
            continue
        window = Window(first, last, last)
        out.append(Finding("road_shock", window, 0.8, float(off[first : last + 1].max())))
    return out
