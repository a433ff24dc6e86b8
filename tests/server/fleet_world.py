"""A box whose batches are stored as an upload stores them, and a worker that works them off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from sqlalchemy import select

from nav_core.mounting.trips import Told
from nav_core.records import Drive, Gnss, Inertial, MountingChange, MountingEstimate, Reason
from server.devices.schemas import DeviceIn
from server.devices.service import register
from server.formats.columns import Columns
from server.formats.drive import from_drive
from server.ingest import service
from server.ingest.service import BatchKey, Upload
from server.jobs.work import Outcome, bring_up_to_date
from server.models import Batch, Change, Vehicle
from server.store import blob_key, open_store

METRES_PER_RADIAN = 6371008.8


class World:
    """One organisation, one box, its batches and its worker."""

    def __init__(self, database, settings, clock, organisation) -> None:
        self.database, self.clock, self.organisation = database, clock, organisation
        self.store = open_store(settings)
        self.device_id = self.new_device()
        self.estimator = gravity_estimator
        self.reconstructor = nothing_happened

    def new_device(self, vehicle_id=None) -> str:
        with self.database.transaction() as session:
            wanted = DeviceIn(name="box", vehicle_id=vehicle_id)
            made, _ = register(session, self.organisation.id, wanted, idempotency_key=None, now=self.clock())
            return made.id

    def put(self, columns: Columns, sequence: int, *, boot="boot", stream="continuous", device_id=None) -> str:
        device_id = device_id or self.device_id
        sha256 = columns.column_sha256()
        key = blob_key(self.organisation.id, device_id, sha256, "parquet")
        content = columns.to_parquet()
        self.store.put(key, content)
        upload = Upload(
            key=BatchKey(stream, boot, sequence),
            media_type="application/vnd.apache.parquet",
            body_sha256=sha256,
            columns=columns,
            column_sha256=sha256,
            blob_sha256=service.bytes_sha256(content),
            blob_key=key,
            body_key=None,
            stored_bytes=len(content),
        )
        with self.database.transaction() as session:
            return service.accept(session, device_id, upload, now=self.clock())[0]

    def bring_up(self, device_id=None) -> Outcome:
        return bring_up_to_date(
            self.database,
            self.store,
            device_id or self.device_id,
            clock=self.clock,
            estimator=self.estimator,
            reconstructor=self.reconstructor,
        )

    def settle(self) -> None:
        """Work off everything, and let the box be silent until nothing is left to review."""
        while self.bring_up().more:
            pass
        for seconds in (30.0, 60.0, 600.0):
            self.clock.advance(seconds=seconds)
            self.bring_up()

    def rows(self, model, *order):
        with self.database.reading() as session:
            return list(session.scalars(select(model).order_by(*order)))

    def one(self, model):
        (row,) = self.rows(model)
        return row

    def kinds(self) -> list[str]:
        return [change.kind for change in self.rows(Change, Change.id)]

    def unprocessed(self) -> int:
        return sum(batch.processed_at is None for batch in self.rows(Batch))


class CarriedWorld(World):
    """The same, with the box in a vehicle."""

    def __init__(self, database, settings, clock, organisation) -> None:
        super().__init__(database, settings, clock, organisation)
        with database.transaction() as session:
            vehicle = Vehicle(organisation_id=organisation.id, name="Panda", created_at=clock())
            session.add(vehicle)
            session.flush()
            self.vehicle_id = vehicle.id
        self.device_id = self.new_device(self.vehicle_id)


def nothing_happened(*_, **__):
    """Finds no events."""
    return ()


def gravity_estimator(ticks, gnss, _past, _noise) -> Told:
    """`by_gravity`, of one stretch at a time."""
    return Told(by_gravity(ticks, gnss), None, 1.0)


def by_gravity(ticks, gnss) -> MountingEstimate:
    """Knows which way is down, ready after a minute, and sees the box being turned upside down."""
    if ticks.index.size < 100:
        return MountingEstimate("insufficient", "whole-drive", reasons=(Reason("short", "Drive on."),))
    up = ticks.f[:, 2] > 0.0
    turned = np.flatnonzero(up[1:] != up[:-1])
    changes = tuple(MountingChange(float(ticks.t[k + 1]), math.pi) for k in turned)
    last = slice(int(turned[-1]) + 1 if turned.size else 0, None)
    R_va = np.diag([1.0, -1.0, -1.0]) if up[-1] else np.eye(3)
    spread = float(np.var(ticks.f[last][:, 0])) + float(np.nanmean(gnss.speed)) * 1e-9
    return MountingEstimate(
        "ready" if ticks.t[-1] - ticks.t[last][0] >= 60.0 else "settling",
        "whole-drive",
        R_va=R_va,
        covariance=np.eye(3) * (1e-4 + spread),
        progress=1.0,
        changes=changes,
    )


@dataclass(frozen=True)
class Leg:
    """Constant speed northward, m/s, for some seconds; `down` -1 turns the box over."""

    seconds: float
    speed: float
    down: float = 1.0


def drive_of(*legs: Leg, rate=20.0, gnss_rate=2.0, start=0.0, utc=1_772_366_400.0, seed=1) -> Drive:
    """A drive along a meridian, its box clock beginning at `start`; `utc` None leaves out UTC."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum([leg.seconds for leg in legs])

    def at(t, name):
        return np.array(
            [getattr(legs[i], name) for i in np.minimum(np.searchsorted(ends, t, side="right"), len(legs) - 1)]
        )

    t = np.arange(0.0, ends[-1], 1.0 / rate)
    f = rng.normal(0.0, 0.05, (t.size, 3))
    f[:, 2] -= 9.81 * at(t, "down")
    tg = np.arange(0.0, ends[-1], 1.0 / gnss_rate)
    speed = at(tg, "speed")
    way = np.concatenate([[0.0], np.cumsum(speed[:-1]) / gnss_rate])
    gnss = Gnss(
        t=start + tg,
        lat=math.radians(45.0) + way / METRES_PER_RADIAN,
        lon=np.full(tg.size, math.radians(7.6)),
        alt=np.full(tg.size, 240.0),
        speed=speed.astype(float),
        course=np.where(speed > 0.5, 0.0, np.nan),
        fix=np.ones(tg.size, dtype=bool),
        utc=None if utc is None else utc + start + tg,
    )
    return Drive(Inertial(start + t, f), gnss)


def cut(drive: Drive, seconds=10.0) -> list[Columns]:
    """Batches of a drive, in order."""
    values = from_drive(drive).values
    index = np.floor((values["t"] - values["t"][0]) / seconds + 1e-9).astype(int)
    return [Columns({name: column[index == k] for name, column in values.items()}) for k in range(int(index[-1]) + 1)]
