"""From a stored mounting result to the words, shape and colour that a person reads; no session, no clock."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from server.wording import marked

State = Literal["good", "attention", "alarm", "unknown"]

SILENT_AFTER = dt.timedelta(hours=24)
"""A parked vehicle's box sleeps; a whole day without a word is worth a look."""
MOVED_IS_NEWS_FOR = dt.timedelta(days=7)
"""How long a moved box stays in the list of what needs attention once it is calibrated again."""
LIVE_WITHIN = dt.timedelta(minutes=2)


@dataclass(frozen=True)
class Standing:
    """How a box stands with its calibration, in the words of the driver."""

    state: State
    headline: str
    percent: int
    sigma_deg: float | None
    """The largest of the three, 1-sigma."""
    moved: bool
    calibrated: bool

    @property
    def percent_says(self) -> bool:
        """Whether the percentage adds something to the headline: only while something is under way."""
        return self.state in ("attention", "unknown") and self.percent > 0


def standing(status: str | None, result: Mapping[str, Any], *, progress: float, moved: bool) -> Standing:
    """Words for an installation; `status` None means that there is none yet."""
    percent = 100 if status == "ready" else math.floor(100 * min(max(progress, 0.0), 1.0))
    sigma = largest_sigma(result)
    words: dict[str | None, tuple[State, str]] = {
        "ready": ("good", marked("Ready")),
        "settling": ("attention", marked("Moved, calibrating again") if moved else marked("Calibrating")),
        "not_fixed": ("alarm", marked("Box is not fixed")),
    }
    waiting: tuple[State, str] = (
        ("attention", marked("Moved, not calibrated yet")) if moved else ("unknown", marked("Not calibrated yet"))
    )
    state, headline = words.get(status, waiting)
    return Standing(state, headline, percent, sigma, moved, calibrated=status == "ready")


def largest_sigma(result: Mapping[str, Any]) -> float | None:
    """Largest 1-sigma over the vehicle's axes, degrees; None where the mounting is not known."""
    sigma: Mapping[str, float] | None = result.get("sigma_deg")
    return None if sigma is None else max(sigma["x"], sigma["y"], sigma["z"])


def angle_to_reference(result: Mapping[str, Any], references: Sequence[Mapping[str, Any]]) -> float | None:
    """Angle between the estimate and the latest known mounting, degrees; None unless both are known."""
    estimate: Sequence[Sequence[float]] | None = result.get("R_va")
    if estimate is None or not references:
        return None
    known: Sequence[Sequence[float]] = references[-1]["R_va"]
    trace = sum(a * b for row, other in zip(estimate, known, strict=True) for a, b in zip(row, other, strict=True))
    return math.degrees(math.acos(min(max((trace - 1.0) / 2.0, -1.0), 1.0)))


BEGINNINGS = {
    "first": marked("First installation"),
    "moved": marked("Box was moved"),
    "swapped": marked("Box came to this vehicle"),
    "manual": marked("Set by hand"),
}
STATUSES = {
    "ready": marked("Ready"),
    "settling": marked("Calibrating"),
    "insufficient": marked("Not calibrated yet"),
    "not_fixed": marked("Box is not fixed"),
}

KINDS = {
    "crash": marked("Crash"),
    "rollover": marked("Rollover"),
    "parked_impact": marked("Impact while parked"),
    "harsh_braking": marked("Harsh braking"),
    "harsh_acceleration": marked("Harsh acceleration"),
    "harsh_cornering": marked("Harsh cornering"),
    "road_shock": marked("Road shock"),
    "handling": marked("Handling of the box"),
}
CLASSES = {
    "car": marked("car"),
    "van": marked("van"),
    "truck": marked("truck"),
    "bus": marked("bus"),
    "motorcycle": marked("motorcycle"),
}


def reasons(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is still missing or worth knowing: a name under which a catalogue may have it, and the English sentence."""
    texts: Sequence[str] = result.get("reasons", ())
    codes: Sequence[str] = result.get("reason_codes", ())
    return [(f"reason:{codes[k]}" if k < len(codes) else text, text) for k, text in enumerate(texts)]
