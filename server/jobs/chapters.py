"""What an installation's older data said of its mounting, kept as evidence instead of being read again.

An estimate reads the data since the last chapter and adds the chapters' evidence.  Once the open
stretch is long enough it becomes a chapter itself.  Late data reopen the newest chapters, as far as
what has to be read again fits an estimate's window; older chapters are joined to one and stay closed,
and what comes late for them is kept but stays out of the estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np

from nav_core.mounting.fusion import TripEvidence, joined, weakened
from nav_core.mounting.model import UNKNOWNS

CHAPTER_S = 1800.0
"""Length of data that closes a chapter."""

SILENT_S = 3600.0
"""The same for data that have nothing to say."""

APART = 3
"""Chapters kept apart, so that late data reopen only the newest."""

REOPENED_S = 5400.0
"""At most this much data is read again."""


@dataclass(frozen=True, slots=True)
class Chapter:
    """Evidence of the data between two UTC times."""

    since_s: float
    until_s: float
    length_s: float
    """Of the data."""
    evidence: TripEvidence | None
    """None where they had nothing to say, as those of a vehicle that stands."""
    input_sha256: str


def read(stored: Sequence[dict[str, Any]], algorithm: str) -> list[Chapter]:
    """Chapters out of an installation's row; those of another algorithm do not count."""
    return [_from_json(entry) for entry in stored if entry["algorithm"] == algorithm]


def written(chapters: Sequence[Chapter], algorithm: str) -> list[dict[str, Any]]:
    """The row's value, oldest chapters joined."""
    while len(chapters) > APART + 1:
        first, second, *rest = chapters
        chapters = [_joined(first, second), *rest]
    return [_to_json(chapter, algorithm) for chapter in chapters]


def reopened(chapters: Sequence[Chapter], since_s: float) -> list[Chapter]:
    """The chapters that data from this UTC on leave closed: all of them where it comes too late."""
    closed = [chapter for chapter in chapters if chapter.until_s <= since_s]
    again = chapters[len(closed) :]
    several = any(chapter.evidence is not None and chapter.evidence.trips > 1 for chapter in again)
    before_all = not closed and bool(again) and since_s < again[0].since_s
    if several or before_all or sum(chapter.length_s for chapter in again) > REOPENED_S:
        return list(chapters)
    return closed


def past(chapters: Sequence[Chapter]) -> TripEvidence | None:
    """The evidence of all of them."""
    told = [chapter.evidence for chapter in chapters if chapter.evidence is not None]
    return joined(told) if told else None


def faded(chapters: Sequence[Chapter], share: float) -> list[Chapter]:
    """The chapters with a share of their weight; without any they are silent, but what they cover stays read."""
    if share == 0.0:
        return [replace(chapter, evidence=None) for chapter in chapters]
    return [
        chapter if chapter.evidence is None else replace(chapter, evidence=weakened(chapter.evidence, share))
        for chapter in chapters
    ]


def input_of(chapters: Sequence[Chapter], stretch_sha256: str) -> str:
    """Hash of all data behind an estimate."""
    if not chapters:
        return stretch_sha256
    return sha256("".join([*(chapter.input_sha256 for chapter in chapters), stretch_sha256]).encode()).hexdigest()


def _joined(first: Chapter, second: Chapter) -> Chapter:
    length_s = first.length_s + second.length_s
    input_sha256 = input_of([first], second.input_sha256)
    return Chapter(first.since_s, second.until_s, length_s, past([first, second]), input_sha256)


_LOWER = np.tril_indices(1 + UNKNOWNS)


def _to_json(chapter: Chapter, algorithm: str) -> dict[str, Any]:
    return {
        "algorithm": algorithm,
        "since_s": chapter.since_s,
        "until_s": chapter.until_s,
        "length_s": chapter.length_s,
        "input_sha256": chapter.input_sha256,
        "evidence": None if chapter.evidence is None else _evidence_to_json(chapter.evidence),
    }


def _evidence_to_json(evidence: TripEvidence) -> dict[str, Any]:
    return {
        "R_va": evidence.R_va.tolist(),
        "lags_s": [evidence.speed_lag, evidence.course_lag],
        "gram": evidence.gram[_LOWER].tolist(),
        "duration_s": evidence.duration,
        "trips": evidence.trips,
        "handed": evidence.handed,
    }


def _from_json(entry: dict[str, Any]) -> Chapter:
    told = entry["evidence"]
    evidence = None if told is None else _evidence_from_json(told)
    return Chapter(entry["since_s"], entry["until_s"], entry["length_s"], evidence, entry["input_sha256"])


def _evidence_from_json(told: dict[str, Any]) -> TripEvidence:
    gram = np.zeros((1 + UNKNOWNS, 1 + UNKNOWNS))
    gram[_LOWER] = told["gram"]
    gram += np.tril(gram, -1).T
    speed_lag, course_lag = told["lags_s"]
    return TripEvidence(
        np.array(told["R_va"]),
        speed_lag,
        course_lag,
        gram,
        told["duration_s"],
        int(told["trips"]),
        told["handed"],
    )
