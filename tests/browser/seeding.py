"""A small fleet in the database and the store, one vehicle for each state that a page can show."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from nav_core.records import Drive
from nav_core.rotation import matrix_to_thesis, thesis_to_matrix
from nav_core.simulate import Scenario, simulate
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.models import (
    Assignment,
    Batch,
    Boot,
    Device,
    DeviceState,
    Installation,
    MountingRevision,
    TrackPoint,
    Trip,
    Vehicle,
    new_id,
)
from server.store import BlobStore, blob_key

DRIVE_S = 240.0
MOUNT = thesis_to_matrix(*np.radians([-20.0, 35.0, 110.0]))
BATCH_S = 60.0


@dataclass(frozen=True)
class Plan:
    """A vehicle of the fleet and what is known of its box."""

    name: str
    plate: str
    lat_deg: float
    lon_deg: float
    status: str | None
    progress: float = 1.0
    sigma_deg: tuple[float, float, float] = (0.35, 0.42, 0.61)
    beginning: str = "first"
    reasons: tuple[str, ...] = ()
    seen_ago_s: float | None = 20.0
    speed_mps: float = 0.0


PLANS = (
    Plan("Fiat Panda", "GA 101 ZZ", 45.4064, 11.8768, "ready", speed_mps=12.4),
    Plan(
        "Iveco Daily",
        "GD 404 ZZ",
        45.4642,
        9.1900,
        "settling",
        0.62,
        (1.1, 1.4, 3.8),
        "moved",
        ("Make two more turns.",),
    ),
    Plan("Jeep Renegade", "GF 606 ZZ", 41.9028, 12.4964, "not_fixed", 0.0, reasons=("The box swings: fix it firmly.",)),
    Plan(
        "Lancia Ypsilon", "GC 303 ZZ", 44.4949, 11.3426, "settling", 0.35, (0.9, 1.2, 6.5), reasons=("Make two turns.",)
    ),
    Plan("Maserati Levante", "GG 707 ZZ", 45.4384, 10.9916, "ready", sigma_deg=(0.2, 0.3, 0.4), seen_ago_s=3 * 86400.0),
    Plan("Piaggio Porter", "GI 909 ZZ", 40.8518, 14.2681, None, seen_ago_s=None),
)


HEALTH = {
    "rate_hz": 100.0,
    "jitter_s": 0.0002,
    "gaps": 1,
    "gap_s": 0.4,
    "gnss_rate_hz": 4.0,
    "fix_share": 0.98,
    "hdop": 0.9,
    "sats": 11.0,
    "temp_c": 31.5,
    "battery_v": None,
    "unreadable_batches": 0,
    "utc_sigma_s": 0.04,
    "remarks": ["rows_out_of_order"],
}


def urban_drive() -> Drive:
    """What the first box recorded."""
    lat, lon = math.radians(PLANS[0].lat_deg), math.radians(PLANS[0].lon_deg)
    scenario = Scenario(duration=DRIVE_S, accel_rate=100.0, R_va=MOUNT, start_lat=lat, start_lon=lon)
    return simulate(scenario, seed=7)[0]


def seed_fleet(
    session: Session, store: BlobStore, organisation_id: str, drive: Drive, *, now: dt.datetime
) -> dict[str, str]:
    """Write the fleet; the first vehicle has raw data and a trip too.  Returns vehicle ids by name."""
    ids: dict[str, str] = {}
    for number, plan in enumerate(PLANS, start=1):
        device = _vehicle_and_box(session, organisation_id, plan, number, now=now)
        ids[plan.name] = str(device.vehicle_id)
        if number == 1:
            _raw_data(session, store, device, from_drive(drive), now=now)
            _trip(session, device, drive, now=now)
            device.reference_mountings = [{"from": now.isoformat(), "R_va": (MOUNT @ _small_turn(0.6)).tolist()}]
    return ids


def add_box_without_vehicle(session: Session, organisation_id: str, *, now: dt.datetime) -> str:
    """A box on the shelf."""
    device = Device(
        id=new_id(), organisation_id=organisation_id, name="SC-spare", token_hash=new_id() * 2, created_at=now
    )
    session.add(device)
    session.flush()
    return device.id


def mount_result(plan: Plan) -> dict[str, Any]:
    """The mount JSON of the contract."""
    known = plan.status in ("ready", "settling")
    theta, phi, psi = (math.degrees(angle) for angle in matrix_to_thesis(MOUNT))
    return {
        "status": plan.status,
        "method": "whole-drive",
        "R_va": MOUNT.tolist() if known else None,
        "euler_deg": {"theta": theta, "phi": phi, "psi": psi} if known else None,
        "sigma_deg": dict(zip("xyz", plan.sigma_deg, strict=True)) if known else None,
        "observability": 0.9 if known else None,
        "stable": plan.status == "ready",
        "reliable": plan.status == "ready",
        "self_test": None,
        "converged_after_s": 64.0 if plan.status == "ready" else None,
        "gps_lag_s": {"speed": 0.2, "course": 0.3} if known else None,
        "changes": [],
        "reasons": list(plan.reasons),
        "percent": round(100 * plan.progress),
        "reason_codes": [],
    }


def _vehicle_and_box(session: Session, organisation_id: str, plan: Plan, number: int, *, now: dt.datetime) -> Device:
    seen = None if plan.seen_ago_s is None else now - dt.timedelta(seconds=plan.seen_ago_s)
    vehicle = Vehicle(id=new_id(), organisation_id=organisation_id, name=plan.name, plate=plan.plate, created_at=now)
    device = Device(
        id=new_id(),
        organisation_id=organisation_id,
        name=f"SC-{number:04d}",
        token_hash=f"{number:064d}",
        created_at=now,
        vehicle_id=vehicle.id,
        last_seen_at=seen,
    )
    session.add(vehicle)
    session.flush()
    session.add(device)
    session.flush()
    session.add(Assignment(device_id=device.id, vehicle_id=vehicle.id, began_at=now))
    if seen is not None:
        session.add(
            DeviceState(
                device_id=device.id,
                updated_at=seen,
                position_at=seen,
                lat_deg=plan.lat_deg,
                lon_deg=plan.lon_deg,
                speed_mps=plan.speed_mps,
                course_rad=0.5,
                health=HEALTH,
            )
        )
    if plan.status is not None:
        _installations(session, device, plan, now=now)
    return device


def _installations(session: Session, device: Device, plan: Plan, *, now: dt.datetime) -> None:
    began = now - dt.timedelta(minutes=40)
    common = {
        "device_id": device.id,
        "vehicle_id": device.vehicle_id,
        "updated_at": now - dt.timedelta(seconds=30),
        "result": mount_result(plan),
        "algorithm": "whole-drive/1",
        "input_sha256": "0" * 64,
    }
    if plan.beginning == "moved":
        moved = now - dt.timedelta(minutes=10)
        before = {**common, "status": "ready", "progress": 1.0, "beginning": "first"}
        session.add(Installation(**before, began_at=began, ended_at=moved))
        session.flush()
        session.add(
            Installation(
                **common,
                status=plan.status,
                progress=plan.progress,
                beginning="moved",
                began_at=moved,
                moved_angle_rad=math.radians(34.0),
            )
        )
    else:
        installation = Installation(
            id=new_id(),
            **common,
            status=plan.status,
            progress=plan.progress,
            beginning=plan.beginning,
            began_at=began,
        )
        session.add(installation)
        session.flush()
        for minute, sigma in enumerate((40.0, 22.0, 9.0, 4.0, 2.2, 1.3, 0.9, max(plan.sigma_deg))):
            result = {**mount_result(plan), "sigma_deg": dict.fromkeys("xyz", sigma)}
            row = {"status": plan.status, "progress": plan.progress, "algorithm": "whole-drive/1"}
            at = began + dt.timedelta(minutes=4 * minute)
            session.add(
                MountingRevision(
                    installation_id=installation.id,
                    data_at=at,
                    created_at=at,
                    result=result,
                    input_sha256="0" * 64,
                    **row,
                )
            )


def _raw_data(session: Session, store: BlobStore, device: Device, columns: Columns, *, now: dt.datetime) -> None:
    t = columns.values["t"]
    offset = now.timestamp() - float(t[-1])
    session.add(
        Boot(
            device_id=device.id,
            boot="b1",
            ordinal=1,
            utc_offset_s=offset,
            utc_sigma_s=0.1,
            utc_source="gnss",
            arrival_offset_s=offset,
            t_first_s=float(t[0]),
            t_last_s=float(t[-1]),
        )
    )
    for sequence, begin in enumerate(np.arange(t[0], t[-1], BATCH_S)):
        rows = (t >= begin) & (t < begin + BATCH_S)
        part = Columns({name: values[rows] for name, values in columns.values.items()})
        data = part.to_parquet()
        key = blob_key(device.organisation_id, device.id, part.column_sha256(), "parquet")
        store.put(key, data)
        session.add(
            Batch(
                organisation_id=device.organisation_id,
                device_id=device.id,
                stream="continuous",
                boot="b1",
                sequence=sequence,
                media_type="application/vnd.apache.parquet",
                body_sha256=part.column_sha256(),
                column_sha256=part.column_sha256(),
                blob_key=key,
                stored_bytes=len(data),
                rows=part.rows,
                t_first_s=float(part.values["t"][0]),
                t_last_s=float(part.values["t"][-1]),
                received_at=now,
                chain_index=sequence,
                chain_sha256="0" * 64,
                processed_at=now,
            )
        )


def _trip(session: Session, device: Device, drive: Drive, *, now: dt.datetime) -> None:
    gnss = drive.gnss
    offset = now.timestamp() - float(max(drive.inertial.t[-1], gnss.t[-1]))
    seconds = np.flatnonzero(np.diff(np.floor(gnss.t), prepend=-1.0) > 0)
    seconds = seconds[np.isfinite(gnss.lat[seconds])]
    trip = Trip(
        id=new_id(),
        organisation_id=device.organisation_id,
        device_id=device.id,
        vehicle_id=device.vehicle_id,
        boot="b1",
        t_first_s=float(gnss.t[seconds[0]]),
        t_last_s=float(gnss.t[seconds[-1]]),
        began_at=dt.datetime.fromtimestamp(offset + gnss.t[seconds[0]], dt.UTC),
        ended_at=dt.datetime.fromtimestamp(offset + gnss.t[seconds[-1]], dt.UTC),
        under_way=True,
        distance_m=float(np.nansum(gnss.speed[seconds])),
        position_distance_m=float(np.nansum(gnss.speed[seconds])),
        moving_s=float(np.sum(gnss.speed[seconds] > 1.5)),
        max_speed_mps=float(np.nanmax(gnss.speed)),
        algorithm="trips/1",
        input_sha256="0" * 64,
    )
    session.add(trip)
    session.flush()
    session.add_all(
        TrackPoint(
            trip_id=trip.id,
            at=dt.datetime.fromtimestamp(offset + gnss.t[row], dt.UTC),
            t_s=float(gnss.t[row]),
            lat_deg=math.degrees(gnss.lat[row]),
            lon_deg=math.degrees(gnss.lon[row]),
            alt_m=float(gnss.alt[row]),
            speed_mps=float(gnss.speed[row]),
            course_rad=None,
        )
        for row in seconds.tolist()
    )


def _small_turn(angle_deg: float) -> Any:
    return thesis_to_matrix(0.0, math.radians(angle_deg), 0.0)
