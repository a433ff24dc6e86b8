"""What an event looks like: how large its change is, whether it lasts, how the box lay before and lies after it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.earth import STANDARD_GRAVITY
from nav_core.events.level import PLAIN, is_plain, usual_force
from nav_core.events.scene import STILL, Scene, scatter_of
from nav_core.events.trigger import THRESHOLD, Stream, Window, change_within, integrate, window_around
from nav_core.typing import Floats

FALLING, FALL_TIME = 0.4 * STANDARD_GRAVITY, 0.08
"""A box whose force stays under this for so long falls, m/s² and s; no road does that for so long."""

FALLS = 0.8
"""Of that time the force is so low, share."""

MINUTE = 60.0
"""So far back a vehicle that brakes is looked at for how it stands, s."""

ROLL_TIME = 6.0
"""A vehicle that turns over is looked at for so long after the blow, s."""

PITCHES = 0.5
"""A vehicle that rolls pitches by less than this share of it; a box that tumbles does not keep to one axis."""

AS_ROLLED = np.radians(35.0)
"""So closely a vehicle that has rolled lies as its roll says, rad."""

LOOKS_AFTER = 0.25
"""So long after a blow its change must still be there, s."""


def core_of(stream: Stream, first: int, last: int) -> int:
    """The sample in a run of triggers from which the next 20 ms change most.

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    first, last : int
        The run, indices into the stream, both included.

    Returns
    -------
    int
        Index into the stream.
    """
    stop = int(np.searchsorted(stream.t, stream.t[last] + 0.15, side="right"))
    return first + int(np.argmax(change_within(stream.rows(slice(first, stop)), 0.020)))


def window_at(scene: Scene, core: int, *, threshold: float = THRESHOLD) -> Window:
    """Window of the event around a core, looked for within two seconds of it.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    core : int
        Index into the scene's stream.
    threshold : float
        Change of velocity within 20 ms that starts an event and at most ends it, m/s (49 CFR 563.5).

    Returns
    -------
    Window
        Indices into the scene's stream.
    """
    stream = scene.stream
    begin, stop = np.searchsorted(stream.t, [stream.t[core] - 1.5, stream.t[core] + 2.0])
    part = slice(int(begin), int(stop))
    level = integrate((stream.f[part] - scene.level)[:, :2], stream.step[part])
    inside = window_around(stream.t[part], stream.v[part, :2], core - int(begin), threshold=threshold, level=level)
    return Window(*(each + int(begin) for each in inside))


def peak_of(stream: Stream, window: Window) -> float:
    """Largest force off its surroundings, m/s².

    Parameters
    ----------
    stream : Stream
        Specific force, V axes, m/s².
    window : Window
        Samples of the event, indices into the stream.

    Returns
    -------
    float
        m/s².
    """
    part = slice(window.zero, window.last + 1)
    return float(np.linalg.norm(stream.f[part] - stream.rest[window.zero], axis=1).max())


class Around(NamedTuple):
    """Where to look for what was before and is after a blow, box clock, s: other blows of its event lie between."""

    begin: float
    """Start of the first of them."""
    until: float
    """Start of the next one; infinity of the last."""
    alone: bool
    """Whether the blow is the only one: else fixes before and after tell of all of them."""


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
    drove: bool
    """Whether the vehicle drove before the first blow."""
    rolled: float
    """How far the vehicle turned about V x by the gyro, rad; 0 of a turn that was none of a vehicle, or not known."""
    shaken: bool
    """Whether the force six to nine seconds later is that of a vehicle that drives."""


def signs_of(scene: Scene, window: Window, around: Around | None = None) -> Signs:
    """Look at an event.

    Parameters
    ----------
    scene : Scene
        A recording, V axes.
    window : Window
        Samples of the event, indices into the scene's stream.
    around : Around, optional
        Other blows of its event; None of a blow that stands alone.

    Returns
    -------
    Signs
        Changes and speeds, m/s, force afterwards, V axes, m/s², angle, rad.
    """
    stream, (zero, end, last) = scene.stream, window
    t0, t_end = float(stream.t[zero]), float(stream.t[end])
    around = around or Around(t0, np.inf, alone=True)
    rest = stream.rest[zero]
    looked = min(t_end + LOOKS_AFTER, max(around.until - 0.005, t_end))
    stop = int(np.searchsorted(stream.t, looked, side="right"))
    a = stream.f[zero:stop] - rest
    # The blow may have ended a braking: what comes after it then gives nothing back.
    freely, later = stream.f[zero:stop] - scene.level, np.arange(zero, stop) > end
    still = np.hypot(freely[:, 0], freely[:, 1]) < np.hypot(a[:, 0], a[:, 1])
    a = np.where((later & still)[:, None], freely, a)
    v = np.cumsum(a[:, :2] * stream.step[zero:stop, None], axis=0)
    size = np.hypot(*v.T)
    change = float(size[: last + 1 - zero].max())
    down = _calm_after(stream, t_end)
    fell = float(np.linalg.norm(rest)) > 1.5 * FALLING and _fell(stream, t0, t_end)
    return Signs(
        change=change,
        kept=float(size[-1] / max(change, 1e-9)),
        fell=fell,
        turned=_turned(stream, around.begin, down),
        down_after=down,
        before=scene.speed_before(t0) if around.alone else None,
        after=scene.speed_after(t_end) if around.alone else None,
        later=scene.speed_after(t_end + 8.0),
        # Held in a hand, a box that falls was not quiet either.
        drove=scene.drove_before(around.begin, by_force=not fell),
        rolled=_rolled(scene, around.begin, t_end, down),
        shaken=(scatter_of(stream, t_end + 6.0, t_end + 9.0) or 0.0) > 2.0 * STILL,
    )


def _rolled(scene: Scene, begin: float, end: float, down: Floats | None) -> float:
    """Largest turn about V x by the gyro, rad; 0 where the box lies otherwise afterwards, or pitched half as much."""
    if scene.w is None:
        return 0.0
    first, last = np.searchsorted(scene.stream.t, [begin - 1.5, end + ROLL_TIME])
    turned = np.cumsum(np.nan_to_num(scene.w[first:last]) * scene.stream.step[first:last, None], axis=0)
    if turned.shape[0] == 0:
        return 0.0
    roll, pitch, _ = np.abs(turned).max(axis=0)
    if pitch > PITCHES * roll:
        return 0.0
    if down is not None:
        angle = float(turned[-1, 0])
        alike = -(down[1] * np.sin(angle) + down[2] * np.cos(angle)) / np.linalg.norm(down)
        if alike < np.cos(AS_ROLLED):
            return 0.0
    return float(roll)


def _turned(stream: Stream, t0: float, down: Floats | None) -> float:
    """How far the force afterwards points elsewhere than before, rad, less what the vehicle's acceleration explains."""
    before = stream.mean(t0 - 2.5, t0 - 0.1)
    if before is None or down is None:
        return 0.0
    explained = 0.0
    if np.linalg.norm(before) > STANDARD_GRAVITY + PLAIN:
        # It braked, or went round a bend: how it stood is told by what came before that, if there is any.
        part = slice(*np.searchsorted(stream.t, [t0 - MINUTE, t0 - 0.1]).tolist())
        earlier = usual_force(stream.t[part], stream.f[part])
        if is_plain(earlier):
            before = earlier
        else:
            explained = float(np.arccos(STANDARD_GRAVITY / np.linalg.norm(before)))
    cosine = float(before @ down / max(np.linalg.norm(before) * np.linalg.norm(down), 1e-9))
    return max(float(np.arccos(np.clip(cosine, -1.0, 1.0))) - explained, 0.0)


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
    if t.size < 2:
        return False
    # Ringing passes through nothing again and again, a box that falls stays there.
    begins = np.flatnonzero(free)
    ends = np.searchsorted(t, t[begins] + FALL_TIME - 1e-9)
    begins, ends = begins[ends < t.size], ends[ends < t.size]
    counted = np.concatenate([[0], np.cumsum(free)])
    return bool(np.any(counted[ends + 1] - counted[begins] >= FALLS * (ends + 1 - begins)))


def speed_seen(signs: Signs) -> float | None:
    """By how much the fixes show the speed to have changed, m/s; None where they do not tell.

    Parameters
    ----------
    signs : Signs
        Of an event.

    Returns
    -------
    float or None
        m/s, not negative.
    """
    return None if signs.before is None or signs.after is None else abs(signs.after - signs.before)
