"""How long a call takes, the same way for every table, and how a table is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple


class Row(NamedTuple):
    """One line of a table; `bar` is what was promised, if anything."""

    name: str
    value: float
    unit: str
    bar: str = ""


def best(function: Callable[[], object], *, repeat: int = 5) -> float:
    """Shortest of a few runs, s; the first, which may compile, is not counted."""
    function()
    durations: list[float] = []
    for _ in range(repeat):
        began = time.perf_counter()
        function()
        durations.append(time.perf_counter() - began)
    return min(durations)


def once(function: Callable[[], object]) -> float:
    """One run, s: for peers that take long and compile nothing."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def print_rows(rows: Iterable[Row]) -> None:
    """Lines for a terminal."""
    for row in rows:
        print(f"{row.name:<68}{row.value:>10.3g} {row.unit:<4}{row.bar and f'  (bar: {row.bar})'}")


def markdown(title: str, rows: Iterable[Row]) -> str:
    """A section with a table."""
    lines = [f"## {title}", "", "| what | measured | bar |", "|---|---|---|"]
    lines += [f"| {row.name} | {row.value:.3g} {row.unit} | {row.bar} |" for row in rows]
    return "\n".join(lines) + "\n"
