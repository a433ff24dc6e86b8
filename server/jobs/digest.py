"""What is kept of a batch for re-estimation: ticks of specific force, fixes, and figures of health.

A stored digest is zstd of: the header's length (4 bytes, little-endian), the header (JSON: format,
arrays as [name, dtype, shape], health, remarks), then the arrays' little-endian bytes one after another.
Tick indices are stored as differences, which compress to almost nothing.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from nav_core.records import Drive, Gnss
from nav_core.signal import TICK_RATE, Ticks, decimate
from nav_core.typing import Floats

FORMAT = 1
MOVING_MPS = 1.5
"""Above this speed the vehicle counts as moving; below, GNSS noise could be all there is."""

_REQUIRED = ("t", "lat", "lon", "alt", "speed", "course")
_OPTIONAL = ("hdop", "sats", "utc")
_LENGTH = struct.Struct("<I")
_MAX_DECODED = 256 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Digest:
    """The conditioned content of one batch, on the clock of its boot."""

    ticks: Ticks
    gnss: Gnss
    health: dict[str, Any]
    remarks: tuple[str, ...]

    @property
    def moving_s(self) -> float:
        """How long the vehicle moved in it."""
        return float(self.health["moving_s"])

    def clock_pair(self) -> tuple[float, float] | None:
        """Box time and UTC minus box time of the batch's fixes; None without UTC."""
        return clock_pair(self.gnss)


def clock_pair(gnss: Gnss) -> tuple[float, float] | None:
    """Box time and UTC minus box time of the fixes; None without UTC."""
    if gnss.utc is None:
        return None
    known = np.isfinite(gnss.utc)
    if not known.any():
        return None
    t = gnss.t[known]
    return float(np.median(t)), float(np.median(gnss.utc[known] - t))


def digest_drive(drive: Drive, battery_v: Floats | None = None) -> Digest:
    """Condition the content of a batch; the battery is told beside it, for no estimate reads it."""
    return Digest(
        ticks=decimate(drive.inertial, TICK_RATE),
        gnss=drive.gnss,
        health={**_health(drive), "battery_v": _middle(battery_v)},
        remarks=tuple(remark.code for remark in drive.remarks),
    )


def _health(drive: Drive) -> dict[str, Any]:
    gnss = drive.gnss
    rate, jitter, gaps, gap_s = _sampling(drive.inertial.t)
    gnss_rate, _, _, _ = _sampling(gnss.t)
    steps = np.clip(np.diff(gnss.t), 0.0, 2.0)
    moving = gnss.fix & (np.nan_to_num(gnss.speed) > MOVING_MPS)
    return {
        "rate_hz": rate,
        "jitter_s": jitter,
        "gaps": gaps,
        "gap_s": gap_s,
        "gnss_rate_hz": gnss_rate,
        "fix_share": float(gnss.fix.mean()) if gnss.t.size else None,
        "hdop": _middle(gnss.hdop),
        "sats": _middle(gnss.sats),
        "temp_c": _middle(drive.inertial.temp),
        "moving_s": float(steps[moving[1:]].sum()),
    }


def _middle(values: Floats | None) -> float | None:
    """Median of what was sampled; None where nothing was."""
    if values is None or not np.isfinite(values).any():
        return None
    return float(np.nanmedian(values))


def _sampling(t: Floats) -> tuple[float | None, float | None, int, float]:
    """Rate, scatter of the steps, number of gaps (over five steps), and their total length."""
    if t.size < 2:
        return None, None, 0, 0.0
    steps = np.diff(t)
    step = float(np.median(steps))
    wide = steps > 5.0 * step
    regular = steps[~wide]
    return 1.0 / step, float(regular.std()), int(wide.sum()), float((steps[wide] - step).sum())


def encode(digest: Digest) -> bytes:
    """Bytes for the database."""
    ticks, gnss = digest.ticks, digest.gnss
    arrays: dict[str, NDArray[Any]] = {
        "index": np.diff(ticks.index, prepend=np.int64(0)),
        "weight": ticks.weight,
        "moment": ticks.moment,
        "square": ticks.square,
        **{name: getattr(gnss, name) for name in _REQUIRED},
        "fix": gnss.fix,
        **{name: values for name in _OPTIONAL if (values := getattr(gnss, name)) is not None},
    }
    arrays = {name: values.astype(values.dtype.newbyteorder("<"), order="C") for name, values in arrays.items()}
    header = json.dumps(
        {
            "format": FORMAT,
            "rate": ticks.rate,
            "arrays": [[name, values.dtype.str, values.shape] for name, values in arrays.items()],
            "health": digest.health,
            "remarks": digest.remarks,
        }
    ).encode()
    content = b"".join([_LENGTH.pack(len(header)), header, *(values.tobytes() for values in arrays.values())])
    return zstandard.ZstdCompressor(level=3).compress(content)


def decode(content: bytes) -> Digest:
    """Digest from the database's bytes."""
    raw = zstandard.ZstdDecompressor().decompress(content, max_output_size=_MAX_DECODED)
    (length,) = _LENGTH.unpack_from(raw)
    at = _LENGTH.size + length
    header = json.loads(raw[_LENGTH.size : at])
    if header["format"] != FORMAT:
        raise ValueError(f"digest of format {header['format']}, this version reads {FORMAT}")
    arrays: dict[str, NDArray[Any]] = {}
    for name, kind, shape in header["arrays"]:
        count = int(np.prod(shape, dtype=np.int64))
        values = np.frombuffer(raw, dtype=np.dtype(kind), count=count, offset=at).reshape(shape)
        arrays[name] = values
        at += values.nbytes
    ticks = Ticks(
        float(header["rate"]), np.cumsum(arrays["index"]), arrays["weight"], arrays["moment"], arrays["square"]
    )
    gnss = Gnss(
        **{name: arrays[name] for name in _REQUIRED},
        fix=arrays["fix"],
        **{name: arrays[name] for name in _OPTIONAL if name in arrays},
    )
    return Digest(ticks, gnss, header["health"], tuple(header["remarks"]))
