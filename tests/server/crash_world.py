"""Events with every field filled, so that what is made of them can be tested without the reconstruction."""

from __future__ import annotations

import datetime as dt
import hashlib
import math

import numpy as np
import zstandard

from nav_core.events.record import (
    ALGORITHM,
    Basis,
    CrashEvent,
    DeltaV,
    Estimate,
    Indices,
    InjuryRisk,
    Pulse,
    SecondImpact,
)
from nav_core.events.way import Driver, Rest, Trajectory
from nav_core.records import Remark
from server.events import queries
from server.events.canonical import canonical, settle
from server.events.document import document_of
from server.jobs.events import batch_json, clock_json, mounting_json
from server.models import Batch, Boot, Device, Event, EventInput, EventRevision, Installation

KMH, DEG, G = 1 / 3.6, math.pi / 180, 9.80665


def crash(t0: float, *, window=None, status="ready", utc_t0=1_772_366_520.25) -> CrashEvent:
    """A frontal offset crash from ahead on the left, 32 km/h, clipped."""
    return CrashEvent(
        kind="crash",
        t0=t0,
        t_end=t0 + 0.13,
        peak=17.9 * G,
        confidence=0.99,
        delta_v=DeltaV(
            longitudinal=Estimate(-30.1 * KMH, -32.4 * KMH, -28.0 * KMH),
            lateral=Estimate(10.9 * KMH, 9.1 * KMH, 12.8 * KMH),
            resultant=Estimate(32.0 * KMH, 29.9 * KMH, 34.3 * KMH),
            vertical=0.3,
            time_of_max=0.1125,
            measured=27.4 * KMH,
            from_gps=31.0 * KMH,
        ),
        pdof=Estimate(-20.0 * DEG, -24.1 * DEG, -15.8 * DEG),
        impact_speed=Estimate(43.2 * KMH, 41.9 * KMH, 44.5 * KMH),
        rebound=None,
        pulse=pulse(),
        clipped_samples=9,
        second_impacts=(
            SecondImpact(
                t0=t0 + 1.42,
                t_end=t0 + 1.51,
                resultant=Estimate(9.0 * KMH, 7.6 * KMH, 10.7 * KMH),
                pdof=Estimate(88.0 * DEG, 76.0 * DEG, 99.0 * DEG),
                clipped_samples=0,
            ),
        ),
        rollover_angle=None,
        rest=Rest(t=t0 + 4.8, lat=41.9030 * DEG, lon=12.4969 * DEG, radius95=4.1, distance=11.2),
        indices=Indices(asi_2010=0.92, asi_1998=0.95, olc=14.2 * G),
        injuries=(
            InjuryRisk(
                curve="NHTSA-2022-all",
                population="occupants of light vehicles, all directions (DOT HS 813 219)",
                level="MAIS3+",
                probability=Estimate(0.025, 0.019, 0.033),
            ),
        ),
        trajectory=trajectory(),
        driver=driver(),
        basis=Basis(
            algorithm=ALGORITHM,
            window=window or (t0 - 30.0, t0 + 30.0),
            sample_rate=200.0,
            full_scale=16.0 * G,
            mounting_status=status,
            mounting_sigma=(0.3 * DEG, 0.4 * DEG, 0.6 * DEG),
            R_va=np.eye(3),
            gyro=False,
            fixes_before=118,
            fixes_after=117,
            speed_lag=0.21,
            course_lag=0.35,
            utc_t0=utc_t0,
            utc_sigma=0.3,
        ),
        quality=(
            Remark("clipped", "9 samples reached the full scale of 16 g; the missing impulse was estimated"),
            Remark("axes_rotating", "No gyro: delta-V is in the box's own axes as they turned"),
        ),
    )


def braking(t0: float, duration: float = 1.2) -> CrashEvent:
    """A harsh braking."""
    return CrashEvent(
        kind="harsh_braking",
        t0=t0,
        t_end=t0 + duration,
        peak=5.6,
        confidence=0.9,
        basis=Basis(
            algorithm=ALGORITHM,
            window=(t0 - 2.0, t0 + duration + 2.0),
            sample_rate=100.0,
            full_scale=None,
            mounting_status="ready",
            mounting_sigma=None,
            R_va=np.eye(3),
            gyro=False,
            fixes_before=8,
            fixes_after=8,
            speed_lag=None,
            course_lag=None,
        ),
    )


def pulse() -> Pulse:
    t = np.arange(-0.02, 0.3, 0.005)
    shape = np.where((t > 0.0) & (t < 0.13), np.sin(np.pi * np.clip(t, 0.0, 0.13) / 0.13), 0.0)
    acceleration = np.outer(shape, [-10.3 * G, 3.73 * G, 0.2 * G])
    delta_v = np.cumsum(acceleration, axis=0) * 0.005
    clipped = (t > 0.05) & (t < 0.085)
    recorded = np.where(clipped[:, None], 0.8 * acceleration, acceleration)
    return Pulse(
        t=t,
        acceleration=acceleration,
        recorded=recorded,
        delta_v=delta_v,
        sigma=0.25 + 0.3 * np.clip(t, 0.0, 0.13) / 0.13,
        clipped=clipped,
        peak=17.9 * G,
        peak_lower_bound=True,
        mean=7.0 * G,
        duration=0.13,
        cutoff=80.0,
        filter="Butterworth 80 Hz, 4 poles, no phase",
    )


def trajectory() -> Trajectory:
    t = np.arange(-30.0, 30.5, 0.5)
    speed = np.where(t < -1.6, 12.5, np.where(t < 0.0, 12.5 + 0.3 * (t + 1.6), np.clip(3.4 - 0.75 * t, 0.0, None)))
    turn = np.where(t < 0.0, 0.012 * t, 0.0)
    heading = 0.6 + turn
    step = np.gradient(t) * speed
    north, east = np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading))
    at = int(np.argmin(np.abs(t)))
    north, east = north - north[at], east - east[at]
    return Trajectory(
        t=t,
        lat=(41.9028 + north / 111_195.0) * DEG,
        lon=(12.4964 + east / (111_195.0 * math.cos(41.9 * DEG))) * DEG,
        position=np.column_stack([north, east]),
        position_covariance=np.tile(np.array([[2.6, 0.8], [0.8, 1.4]]), (t.size, 1, 1)),
        speed=speed,
        speed_sigma=np.full(t.size, 0.25),
        heading=heading,
        heading_sigma=np.full(t.size, 0.03),
        acceleration=np.column_stack([np.gradient(speed, t), 0.012 * speed]),
        method="gps-inertial",
    )


def driver() -> Driver:
    t = np.arange(-5.0, 0.5, 0.5)
    speed = np.where(t < -1.6, 12.5, 12.5 + 0.3 * (t + 1.6))
    return Driver(
        t=t,
        speed=speed,
        longitudinal=np.where(t < -1.6, 0.1, -3.1),
        lateral=np.full(t.size, 0.15),
        yaw_rate=np.full(t.size, 0.012),
        braked_from=-1.6,
        braking=4.2,
        steered="none",
        stopping_distance=24.3,
    )


def store_event(
    session, made: CrashEvent, device: Device, boot: Boot, batches: list[Batch], installation: Installation, **fields
) -> Event:
    """The rows of an event as the job stores them, its first revision."""
    inputs = settle(
        {
            "batches": [batch_json(batch) for batch in batches],
            "between_s": [made.t0 - 1.5, made.t0 + 1.5],
            "mounting": mounting_json(installation),
            "vehicle_class": "car",
            "clock": clock_json(boot),
        }
    )
    document = settle(document_of(made, inputs, device_id=device.id, boot=boot.boot))
    content, now = canonical(document), dt.datetime.now(dt.UTC)
    row = Event(
        organisation_id=device.organisation_id,
        device_id=device.id,
        vehicle_id=device.vehicle_id,
        boot=boot.boot,
        kind=made.kind,
        severe=True,
        t0_s=made.t0,
        t_end_s=made.t_end,
        at=boot.utc(made.t0),
        created_at=now,
        updated_at=now,
        revision=1,
        result=document["event"],
        **fields,
    )
    session.add(row)
    session.flush()
    session.add(
        EventRevision(
            event_id=row.id,
            number=1,
            created_at=now,
            installation_id=installation.id,
            algorithm=document["algorithm"],
            input_sha256=document["inputs"]["sha256"],
            event_sha256=hashlib.sha256(content).hexdigest(),
            document=zstandard.ZstdCompressor().compress(content),
            **queries.names(session, device.id, device.vehicle_id),
        )
    )
    session.add_all(EventInput(event_id=row.id, batch_id=batch.id) for batch in batches)
    session.flush()
    return row


class Reconstructor:
    """Finds the events it was given where their time zero lies in the span and the data reach that far."""

    def __init__(self, *events) -> None:
        self.events = list(events)
        self.calls = []

    def __call__(self, drive, mounting, *, vehicle_class="car", between=None):
        self.calls.append((between, mounting, vehicle_class))
        t = drive.inertial.t
        first, last = between or (-math.inf, math.inf)
        return tuple(e for e in self.events if first <= e.t0 <= last and t[0] <= e.t0 <= t[-1])
