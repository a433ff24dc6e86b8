"""A vehicle with a box, drives, a crash and a manoeuvre, all worked off, for tests of retention and erasure."""

from __future__ import annotations

import datetime as dt

from crash_world import Reconstructor, braking, crash
from fleet_world import Leg, World, cut, drive_of

from server.models import Vehicle

DRIVE = (Leg(100, 12.0), Leg(400, 0.0), Leg(200, 9.0))
T0, BRAKED = 60.0, 600.0


class Fleet(World):
    """One vehicle, one box that was in it from the start."""

    def __init__(self, database, settings, clock, organisation) -> None:
        super().__init__(database, settings, clock, organisation)
        with database.transaction() as session:
            vehicle = Vehicle(organisation_id=organisation.id, name="Van", plate="AB123CD", created_at=clock())
            session.add(vehicle)
            session.flush()
            self.vehicle_id = vehicle.id
        self.device_id = self.new_device(self.vehicle_id)
        self.reconstructor = Reconstructor(crash(T0), braking(BRAKED))

    def drive(self) -> None:
        for k, batch in enumerate(cut(drive_of(*DRIVE), seconds=20.0)):
            self.put(batch, k)
        self.settle()

    def pass_time(self, **by: float) -> dt.datetime:
        """Time goes on, by the wall too: blobs of files bear its time."""
        self.clock.now = max(self.clock.now, dt.datetime.now(dt.UTC)) + dt.timedelta(**by)
        return self.clock.now

    def drive_on(self) -> None:
        """The same box some time later, on another run of its clock."""
        for k, batch in enumerate(cut(drive_of(Leg(60, 11.0), utc=1_772_466_400.0, seed=7), seconds=20.0)):
            self.put(batch, k, boot="later")
        self.settle()
