"""Readers of the real recordings that tests use; each gives a `Drive` in SI units.

The recordings are not part of the project.  `SCATOLA_TEST_DATA` names the folder that holds them.
"""

from __future__ import annotations

import csv
import os
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from nav_core.earth import ecef_to_geodetic
from nav_core.records import Drive, Gnss, Inertial
from nav_core.rotation import skew
from nav_core.timebase import in_order


def folder(name: str) -> Path:
    """Folder of one recording; skips the test when the recordings are not at hand."""
    root = os.environ.get("SCATOLA_TEST_DATA")
    if not root:
        pytest.skip("SCATOLA_TEST_DATA is not set: it names the folder of real recordings")
    path = Path(root) / name
    if not path.is_dir():
        pytest.skip(f"no recording {name} in SCATOLA_TEST_DATA")
    return path


def _rows(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        header = [name.strip() for name in next(reader)]
        values = [[float(cell) if cell.strip() else np.nan for cell in row] for row in reader]
    return header, np.array(values)


def _ordered(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    keep = in_order(t).keep
    return t[keep], values[keep]


def corolla() -> Drive:
    """Phone on the dash, x forward, y left, z up: R_va = diag(1, -1, -1), by eye."""
    base = folder("corolla-phone-aligned")
    _, accel = _rows(base / "accel.csv")
    _, gps = _rows(base / "gps.csv")
    t, f = _ordered(1e-3 * accel[:, 0], accel[:, 1:4])
    tg, fixes = _ordered(1e-3 * gps[:, 0], gps[:, 1:])
    return Drive(
        Inertial(t=t, f=f),
        Gnss(
            t=tg,
            lat=np.radians(fixes[:, 0]),
            lon=np.radians(fixes[:, 1]),
            alt=fixes[:, 5],
            speed=fixes[:, 2] / 3.6,
            course=np.radians(fixes[:, 3]),
            fix=np.isfinite(fixes[:, 2]),
            sats=fixes[:, 4],
        ),
    )


def comma2k19(*, with_gyro: bool = False) -> Drive:
    """A nearly straight minute; box axes close to forward, right, down."""
    base = folder("comma2k19-rav4-1min")
    _, accel = _rows(base / "imu_accel.csv")
    _, gyro = _rows(base / "imu_gyro.csv")
    _, gnss = _rows(base / "gnss_ublox.csv")
    t, f = _ordered(accel[:, 0], accel[:, 1:4])
    tg, fixes = _ordered(gnss[:, 0], gnss[:, 1:])
    w = np.column_stack([np.interp(t, gyro[:, 0], axis) for axis in gyro[:, 1:4].T]) if with_gyro else None
    return Drive(
        Inertial(t=t, f=f, w=w),
        Gnss(
            t=tg,
            lat=np.radians(fixes[:, 0]),
            lon=np.radians(fixes[:, 1]),
            alt=fixes[:, 4],
            speed=fixes[:, 2],
            course=np.radians(fixes[:, 5]),
            fix=np.isfinite(fixes[:, 2]),
            utc=1e-3 * fixes[:, 3],  # the file's column is in milliseconds
        ),
    )


def comma2k19_place() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moments, latitude and longitude, rad, of the pose of the recording, which cameras helped to make."""
    _, pose = _rows(folder("comma2k19-rav4-1min") / "truth_global_pose.csv")
    lat, lon, _ = ecef_to_geodetic(pose[:, 3:6])
    return pose[:, 0], lat, lon


def comma2k19_travel_direction() -> np.ndarray:
    """Mean direction of travel in the box's axes, from the pose of the recording, shape (3,)."""
    _, pose = _rows(folder("comma2k19-rav4-1min") / "truth_global_pose.csv")
    velocity, quaternion = pose[:, 6:9], pose[:, 9:13]
    local = []
    for v, (w, x, y, z) in zip(velocity, quaternion, strict=True):
        if np.linalg.norm(v) > 10.0:
            K = skew(np.array([x, y, z]))
            R = np.eye(3) + 2.0 * w * K + 2.0 * K @ K
            local.append(R.T @ v / np.linalg.norm(v))
    mean = np.mean(local, axis=0)
    return mean / np.linalg.norm(mean)


def loose_phone() -> Drive:
    """A phone that was handled during the drive: there is no mounting."""
    path = folder("sbussmann-boston-loose-phone") / "nickandroid_exp2.csv"
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    stamps = [datetime.strptime(row["YYYY-MO-DD HH-MI-SS_SSS"], "%Y-%m-%d %H:%M:%S:%f") for row in rows]  # noqa: DTZ007  box clock
    t = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])

    def column(name: str) -> np.ndarray:
        key = next(k for k in rows[0] if k.startswith(name))
        return np.array([float(row[key]) if row[key].strip() else np.nan for row in rows])

    f = np.stack([column(f"ACCELEROMETER {axis}") for axis in "XYZ"], axis=1)
    fixes = np.stack(
        [
            column("LOCATION Latitude"),
            column("LOCATION Longitude"),
            column("LOCATION Altitude ("),
            column("LOCATION Speed"),
            column("LOCATION ORIENTATION"),
        ],
        axis=1,
    )
    t, columns = _ordered(t, np.column_stack([f, fixes]))
    f, fixes = columns[:, :3], columns[:, 3:]
    fresh = np.concatenate([[True], np.any(np.diff(fixes[:, :2], axis=0) != 0.0, axis=1)])
    fixes, tg = fixes[fresh], t[fresh]
    return Drive(
        Inertial(t=t, f=f),
        Gnss(
            t=tg,
            lat=np.radians(fixes[:, 0]),
            lon=np.radians(fixes[:, 1]),
            alt=fixes[:, 2],
            speed=fixes[:, 3] / 3.6,
            course=np.radians(fixes[:, 4]),
            fix=np.isfinite(fixes[:, 3]),
        ),
    )
