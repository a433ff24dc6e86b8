"""The element table of 49 CFR 563 filled from an event, "not recorded" where a box cannot know."""

from __future__ import annotations

from dataclasses import dataclass

from nav_core.events.record import CrashEvent


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
    """Elements of tables I and II in the order of the regulation; none yet."""
    del event
    return ()
