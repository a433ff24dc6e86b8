"""The thesis' watch over a box that may have been moved (001 §5.5, right half of fig. 6.2).

The program is started again from time to time and runs until its test routine passes; the mounting that it then
saves is compared with the one in memory.  "A substantial difference" is an alarm, and the new one is saved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.errors import TooLittleDataError
from nav_core.mounting.online_stream import fixes_where
from nav_core.mounting.thesis import run_thesis
from nav_core.mounting.thesis_model import Errata, ErrataName
from nav_core.records import Drive, Inertial, MountingChange
from nav_core.rotation import angle_between
from nav_core.typing import Floats

PERIOD = 300.0
"""Between two starts of the program, s; the thesis gives no figure."""

SUBSTANTIAL = np.radians(15.0)
"""rad; the thesis gives no figure.  Three times its mean error about psi (table 5.3)."""


class Start(NamedTuple):
    """One start of the program.

    Attributes
    ----------
    begin : float
        Box time of the start, s.
    saved : float or None
        Box time at which its test routine passed and its mounting was saved, s; None if it never did.
    R_va : ndarray, shape (3, 3), or None
        The saved mounting.
    """

    begin: float
    saved: float | None
    R_va: Floats | None


class Watch(NamedTuple):
    """What periodic starts saw."""

    starts: tuple[Start, ...]
    changes: tuple[MountingChange, ...]
    R_va: Floats | None
    """The mounting in memory at the end."""


def watch(
    drive: Drive,
    *,
    period: float = PERIOD,
    limit: float = SUBSTANTIAL,
    errata: ErrataName | Errata = "corrected",
    memory: Floats | None = None,
) -> Watch:
    """Run the thesis' program again and again over a recording and compare what it saves.

    Parameters
    ----------
    drive : Drive
    period : float
        s.
    limit : float
        Angle from which a difference is a move, rad.
    errata : {"corrected", "printed"} or Errata
    memory : ndarray, shape (3, 3), optional
        A mounting saved earlier.

    Returns
    -------
    Watch
        A change is dated when the differing mounting was saved.  A smaller difference leaves the memory as it is.
    """
    starts: list[Start] = []
    changes: list[MountingChange] = []
    t = drive.gnss.t
    begins = np.arange(t[0], t[-1], period) if t.size else t
    for begin in begins.tolist():
        start = _start(_between(drive, begin, begin + period), begin, errata)
        starts.append(start)
        if start.R_va is None or start.saved is None:
            continue
        if memory is None:
            memory = start.R_va
        elif (angle := angle_between(start.R_va, memory)) > limit:
            changes.append(MountingChange(start.saved, angle))
            memory = start.R_va
    return Watch(tuple(starts), tuple(changes), memory)


def _start(drive: Drive, begin: float, errata: ErrataName | Errata) -> Start:
    try:
        run = run_thesis(drive, errata=errata)
    except TooLittleDataError:
        return Start(begin, None, None)
    if run.flow.finished is None:
        return Start(begin, None, None)
    tested = run.flow.trials[-1].saved
    R_va = Rotation.from_quat(run.flow.mean[tested]).as_matrix()
    return Start(begin, float(run.steps.t[run.flow.finished]), R_va)


def _between(drive: Drive, begin: float, end: float) -> Drive:
    inertial, gnss = drive.inertial, drive.gnss
    samples = (inertial.t >= begin) & (inertial.t < end)
    fixes = fixes_where(gnss, (gnss.t >= begin) & (gnss.t < end))
    return Drive(Inertial(inertial.t[samples], inertial.f[samples]), fixes)
