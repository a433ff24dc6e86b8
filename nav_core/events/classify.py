"""What an event was, from physics: does the change of velocity last, does GPS see it, does the box still lie as before.

A pothole gives back what it takes; a dropped box falls freely first and lies differently afterwards; a door slam
happens at standstill and is over in a vibration; braking, however hard, changes velocity too slowly for the trigger.
"""

from __future__ import annotations

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.faint import bumps, shocks, swipes, tilted
from nav_core.events.finding import OVER, SEVERE, TURNED, Finding
from nav_core.events.record import EventKind
from nav_core.events.scene import CARRIED, MOVES, Scene, restless
from nav_core.events.signs import Around, Signs, core_of, peak_of, signs_of, speed_seen, window_at
from nav_core.events.trigger import MULTI_EVENT, TRIGGER, TRIGGER_WINDOW, Window, groups
from nav_core.records import Remark
from nav_core.typing import Integers

LASTS = 0.35
"""A blow keeps at least this share of its change 0.25 s later."""

TOGETHER = 0.3
"""Triggers closer than this are looked at together, s: a wheel after the other, a box that bounces."""


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
    violent = stream.strongest
    found: list[Finding] = []
    for first, last in groups(violent >= TRIGGER, stream.t, TOGETHER):
        flagged = first + np.flatnonzero(violent[first : last + 1] >= TRIGGER)
        found += _judged_together(scene, _windows(scene, flagged), found)
    found += swipes(scene, found)
    found += bumps(scene, found)
    found += tilted(scene, found)
    found += shocks(scene, found)
    return sorted(found, key=lambda each: each.window.zero)


def _windows(scene: Scene, flagged: Integers) -> list[Window]:
    """Windows of the events in a run of triggers, the strongest first: what begins after an end is a further event."""
    out: list[Window] = []
    stream, t = scene.stream, scene.stream.t
    while flagged.size:
        window = window_at(scene, core_of(stream, int(flagged[0]), int(flagged[-1])))
        out.append(window)
        # A trigger looks ahead: what ends before time zero, or begins after the end, is of another event.
        apart = (t[flagged] + TRIGGER_WINDOW <= t[window.zero]) | (flagged > window.last)
        if not apart.any():
            break
        # The larger part first; both are looked at if need be.
        rest = flagged[apart]
        early, late = rest[rest < window.zero], rest[rest > window.last]
        out += _windows(scene, early) if late.size else []
        flagged = late if late.size else early
    return out


def _judged_together(scene: Scene, windows: list[Window], found: list[Finding]) -> list[Finding]:
    """What the events of a run of triggers were: all what the strongest was, unless that was a blow to the vehicle."""
    t = scene.stream.t
    strongest, ordered = windows[0], sorted(windows)
    earlier = _struck_before(scene, float(t[ordered[0].zero]), found)
    begin = float(t[ordered[0].zero]) if earlier is None else earlier
    alone = len(windows) == 1 and earlier is None
    out: list[Finding] = []
    for window in [strongest, *(each for each in ordered if each is not strongest)]:
        after = [float(t[each.zero]) for each in ordered if each.zero > window.zero]
        out.append(_judged(scene, window, Around(begin, min(after, default=np.inf), alone=alone)))
        if out[0].kind not in SEVERE:
            break
    return out


def _struck_before(scene: Scene, t: float, found: list[Finding]) -> float | None:
    """Start of the event, if there is one, that a blow at `t` is part of, box clock, s."""
    times = [float(scene.stream.t[each.window.zero]) for each in found if each.kind in SEVERE]
    return min((each for each in times if t - MULTI_EVENT <= each < t), default=None)


def _judged(scene: Scene, window: Window, around: Around) -> Finding:
    """What an event that meets the trigger was."""
    stream = scene.stream
    signs = signs_of(scene, window, around)
    stood = scene.stands_before(around.begin)
    if stood and restless(stream, around.begin - 1.2, around.begin - 0.1) > CARRIED:
        remark = Remark("shaken_before", "The box was moved about before the shock while its vehicle stood.")
        return Finding("handling", window, 0.85, peak_of(stream, window), (remark,))
    kind, confidence, remarks = _verdict(signs, stood)
    return Finding(kind, window, confidence, peak_of(stream, window), remarks)


Verdict = tuple[EventKind, float, tuple[Remark, ...]]


def _verdict(signs: Signs, stood: bool) -> Verdict:
    moved, drove_on = signs.drove, signs.later is not None and signs.later > MOVES
    remarks: tuple[Remark, ...] = ()
    if signs.turned > TURNED:
        degrees = float(np.degrees(signs.turned))
        remarks = (Remark("box_turned", f"The box lies {degrees:.0f}° differently after it."),)
    if moved and not drove_on and _rolled(signs):
        return "rollover", 0.95, () if signs.rolled > OVER else remarks
    harmless = _harmless(signs, stood, moved, drove_on)
    if harmless is not None:
        return harmless
    if _on_its_side(signs) and moved and not drove_on:
        return "rollover", 0.9, ()
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
    seen = speed_seen(signs)
    if seen is None:
        return None
    if seen > max(0.35 * signs.change, 1.0):
        return False
    # Across the way a change v turns the course and adds v²/(2 speed): not seen in the speed.
    return None if signs.kept >= LASTS else seen < max(0.2 * signs.change, 0.8)


def _slowed(signs: Signs) -> bool:
    """Whether the fixes show most of the change as a change of speed."""
    seen = speed_seen(signs)
    return seen is not None and seen > 0.6 * signs.change


def _rolled(signs: Signs) -> bool:
    """Whether the vehicle turned over, as a falling box would not; what else happened is part of that."""
    if signs.later is None and signs.shaken:  # neither fixes nor the force say that it stands now
        return False
    # A roof takes the fixes away: of a box that fell in a vehicle that drives, they go on.
    return signs.rolled > OVER or (signs.later is None and signs.after is None and _on_its_side(signs))


def _on_its_side(signs: Signs) -> bool:
    down = signs.down_after
    if down is None or signs.turned < OVER:
        return False
    # Over its side a vehicle ends without pitch; a box that came loose ends anyhow.
    return bool(abs(down[0]) < 0.4 * STANDARD_GRAVITY and -down[2] < np.cos(OVER) * np.linalg.norm(down))
