"""The tables, one file per aggregate; importing this package maps them all."""

from server.models.access import SignInCode, ViewTicket, WebSession
from server.models.account import ApiKey, AuditEntry, User
from server.models.alert import (
    AccidentClaim,
    Alert,
    AlertChannel,
    AlertDelivery,
    AlertRule,
    DeliveryAttempt,
    GeofencePresence,
    TheftWatch,
)
from server.models.analysis import Analysis
from server.models.base import Base, new_id
from server.models.batch import Batch, BatchDigest, SequenceRun
from server.models.change import Change
from server.models.device import Boot, ClaimCode, Device, DeviceRequest, DeviceState, Diagnosis
from server.models.event import ChainSeal, Event, EventAction, EventInput, EventRevision
from server.models.installation import Installation, MountingRevision
from server.models.job import JobAttempt, JobFailure, Rerun, RerunItem
from server.models.organisation import Organisation
from server.models.privacy import Erasure, RetentionRule
from server.models.trip import TrackPoint, Trip
from server.models.vehicle import Assignment, Vehicle

__all__ = [
    "AccidentClaim",
    "Alert",
    "AlertChannel",
    "AlertDelivery",
    "AlertRule",
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
    "DeliveryAttempt",
    "Device",
    "DeviceRequest",
    "DeviceState",
    "Diagnosis",
    "Erasure",
    "Event",
    "EventAction",
    "EventInput",
    "EventRevision",
    "GeofencePresence",
    "Installation",
    "JobAttempt",
    "JobFailure",
    "MountingRevision",
    "Organisation",
    "Rerun",
    "RerunItem",
    "RetentionRule",
    "SequenceRun",
    "SignInCode",
    "TheftWatch",
    "TrackPoint",
    "Trip",
    "User",
    "Vehicle",
    "ViewTicket",
    "WebSession",
    "new_id",
]
