"""What an installation's older data said of its mounting, kept as evidence instead of being read again.

An estimate reads the data since the last chapter and adds the chapters' evidence.  Once the open
stretch is long enough it becomes a chapter itself.  Old chapters are joined to one; data that come
so late that they belong before it stay out of the estimates until a re-run (`scatola reprocess`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np

from nav_core.mounting.fusion import TripEvidence, joined

CHAPTER_S = 1800.0
"""Length of data that closes a chapter."""

APART = 8
"""Chapters kept apart, so that late data reopen only the newest."""


@dataclass(frozen=True, slots=True)
class Chapter:
    """Evidence of the data between two UTC times."""

    since_s: float
    until_s: float
    evidence: TripEvidence
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
    """The chapters that data from this UTC on leave closed.

    Data older than all of them reopen nothing where the first holds several: its data would not fit one estimate.
    """
    kept = [chapter for chapter in chapters if chapter.until_s <= since_s]
    return kept or [chapter for chapter in chapters[:1] if chapter.evidence.trips > 1]


def past(chapters: Sequence[Chapter]) -> TripEvidence | None:
    """The evidence of all of them."""
    return joined([chapter.evidence for chapter in chapters]) if chapters else None


def input_of(chapters: Sequence[Chapter], stretch_sha256: str) -> str:
    """Hash of all data behind an estimate."""
    if not chapters:
        return stretch_sha256
    return sha256("".join([*(chapter.input_sha256 for chapter in chapters), stretch_sha256]).encode()).hexdigest()


def _joined(first: Chapter, second: Chapter) -> Chapter:
    evidence = joined([first.evidence, second.evidence])
    return Chapter(first.since_s, second.until_s, evidence, input_of([first], second.input_sha256))


_LOWER = np.tril_indices(14)


def _to_json(chapter: Chapter, algorithm: str) -> dict[str, Any]:
    evidence = chapter.evidence
    return {
        "algorithm": algorithm,
        "since_s": chapter.since_s,
        "until_s": chapter.until_s,
        "input_sha256": chapter.input_sha256,
        "R_va": evidence.R_va.tolist(),
        "lags_s": [evidence.speed_lag, evidence.course_lag],
        "gram": evidence.gram[_LOWER].tolist(),
        "duration_s": evidence.duration,
        "trips": evidence.trips,
    }


def _from_json(entry: dict[str, Any]) -> Chapter:
    gram = np.zeros((14, 14))
    gram[_LOWER] = entry["gram"]
    gram += np.tril(gram, -1).T
    speed_lag, course_lag = entry["lags_s"]
    evidence = TripEvidence(
        np.array(entry["R_va"]), speed_lag, course_lag, gram, entry["duration_s"], int(entry["trips"])
    )
    return Chapter(entry["since_s"], entry["until_s"], evidence, entry["input_sha256"])
