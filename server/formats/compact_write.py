"""Writing compact batches: what a box does in C, for the reference client and for tests."""

from __future__ import annotations

import math
import zlib

import numpy as np

from server.errors import InvalidError
from server.formats.columns import NAMES, Columns, Floats
from server.formats.compact import (
    ALIGNMENT,
    BLOCK,
    COLUMN,
    CRC,
    EVEN,
    HEAD,
    INT8,
    INT16,
    INT32,
    MAGIC,
    STEPS_16,
    STEPS_32,
    VERSION,
    Ticks,
)

TICKS_PER_S = 1_000_000
# Type and resolution of each column, finer than what sensors of a box resolve.  A value that does not
# fit makes the resolution of its column coarser, by twos, as far as needed.
RESOLUTIONS: dict[str, tuple[int, float]] = {
    **dict.fromkeys(("fx", "fy", "fz"), (INT16, 0.001)),
    **dict.fromkeys(("wx", "wy", "wz"), (INT16, 0.0001)),
    **dict.fromkeys(("mx", "my", "mz"), (INT16, 0.01)),
    "temp": (INT16, 0.01),
    "lat": (INT32, 1e-7),
    "lon": (INT32, 1e-7),
    "alt": (INT32, 0.001),
    "speed": (INT16, 0.005),
    "course": (INT16, 0.02),
    "fix": (INT8, 1.0),
    "hdop": (INT16, 0.01),
    "sats": (INT8, 1.0),
    "utc": (INT32, 0.001),
    "battery": (INT16, 0.001),
    "ignition": (INT8, 1.0),
}
_INERTIAL = ("fx", "fy", "fz", "wx", "wy", "wz", "mx", "my", "mz", "temp")
_DTYPES = {INT8: "<i1", INT16: "<i2", INT32: "<i4"}


def write(columns: Columns, *, ticks_per_s: int = TICKS_PER_S) -> bytes:
    """A compact body: inertial values in one block, all else in another; rows must be in the order of time."""
    blocks = [
        block
        for names in (_INERTIAL, tuple(name for name in NAMES[1:] if name not in _INERTIAL))
        if (block := _block(columns, names, ticks_per_s))
    ]
    if not blocks:
        raise InvalidError("Nothing but times: there is nothing to send", code="compact")
    body = b"".join(blocks)
    length = HEAD.size + len(body) + CRC.size
    whole = HEAD.pack(MAGIC, VERSION, len(blocks), 0, length, ticks_per_s) + body
    return whole + CRC.pack(zlib.crc32(whole))


def _block(columns: Columns, names: tuple[str, ...], ticks_per_s: int) -> bytes:
    """The rows in which any of `names` was sampled; nothing where there are none."""
    present = [name for name in names if name in columns.values]
    sampled = np.zeros(columns.rows, dtype=np.bool_)
    for name in present:
        sampled |= ~np.isnan(columns.values[name])
    rows = np.flatnonzero(sampled)
    present = [name for name in present if not np.isnan(columns.values[name][rows]).all()]
    if rows.size == 0:
        return b""
    ticks: Ticks = np.rint(columns.values["t"][rows] * ticks_per_s).astype(np.int64)
    step, kind, steps = _steps(ticks)
    described: list[bytes] = []
    arrays: list[bytes] = []
    for name in present:
        description, array = _column(name, columns.values[name][rows])
        described.append(description)
        arrays.append(array)
    head = BLOCK.pack(rows.size, len(present), kind, 0, int(ticks[0]), step, 0)
    return b"".join([head, *described, _padded(steps), *arrays])


def _steps(ticks: Ticks) -> tuple[int, int, bytes]:
    """Step, kind and array of a block's times."""
    steps = np.diff(ticks, prepend=ticks[0])
    if (steps < 0).any():
        raise InvalidError("Time goes back: a compact batch holds its rows in order", code="compact")
    if steps.max() >= 2**32:
        raise InvalidError("More than 2^32 ticks lie between two rows: send two batches", code="compact")
    if ticks.size == 1 or (steps[1:] == steps[1]).all():
        return int(steps[-1]), EVEN, b""
    if steps.max() < 2**16:
        return 0, STEPS_16, steps.astype("<u2").tobytes()
    return 0, STEPS_32, steps.astype("<u4").tobytes()


def _column(name: str, values: Floats) -> tuple[bytes, bytes]:
    """Description and array of a column."""
    kind, scale = RESOLUTIONS[name]
    offset = float(np.floor(np.nanmin(values))) if name == "utc" else 0.0
    limit = 2 ** (8 * kind - 1) - 1
    largest = float(np.nanmax(np.abs(values - offset)))
    # Half a step of room: rounding must not reach the value that means "not sampled".
    if largest > (limit + 0.5) * scale:
        scale *= 2.0 ** math.ceil(math.log2(largest / (limit * scale)))
    missing = np.isnan(values)
    raw = np.rint((np.where(missing, offset, values) - offset) / scale)
    raw = np.where(missing, -limit - 1, np.clip(raw, -limit, limit)).astype(_DTYPES[kind])
    return COLUMN.pack(NAMES.index(name), kind, 0, 0, scale, offset), _padded(raw.tobytes())


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % ALIGNMENT)
