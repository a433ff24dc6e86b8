"""The tables, one file per aggregate; importing this package maps them all."""

from server.models.access import SignInCode, ViewTicket, WebSession
from server.models.account import ApiKey, AuditEntry, User
from server.models.analysis import Analysis
from server.models.base import Base, new_id
from server.models.batch import Batch, BatchDigest, SequenceRun
from server.models.change import Change
from server.models.device import Boot, ClaimCode, Device, DeviceRequest, DeviceState
from server.models.event import ChainSeal, Event, EventAction, EventInput, EventRevision
from server.models.installation import Installation, MountingRevision
from server.models.organisation import Organisation
from server.models.trip import TrackPoint, Trip
from server.models.vehicle import Assignment, Vehicle

__all__ = [
    "Analysis",
    "ApiKey",
    "Assignment",
    "AuditEntry",
    "Base",
    "Batch",
    "BatchDigest",
    "Boot",
    "ChainSeal",
    "Change",
    "ClaimCode",
    "Device",
    "DeviceRequest",
    "DeviceState",
    "Event",
    "EventAction",
    "EventInput",
    "EventRevision",
    "Installation",
    "MountingRevision",
    "Organisation",
    "SequenceRun",
    "SignInCode",
    "TrackPoint",
    "Trip",
    "User",
    "Vehicle",
    "ViewTicket",
    "WebSession",
    "new_id",
]
