"""No caller reaches another organisation, whatever route and method it tries; no role reaches more than it may."""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass

import httpx
import numpy as np
import pytest
import sqlalchemy as sa
from crash_world import crash, store_event
from fastapi import FastAPI
from fastapi.routing import APIRoute
from sqlalchemy.orm import Session

from server.accounts.access import needs
from server.accounts.permissions import PERMISSIONS, ROLE_PERMISSIONS
from server.database import Database
from server.errors import NotFoundError
from server.formats.columns import Columns
from server.installations.blank import blank_result
from server.isolation import EVERYWHERE
from server.models import (
    AccidentClaim,
    Alert,
    AlertChannel,
    AlertDelivery,
    AlertRule,
    Analysis,
    ApiKey,
    Assignment,
    AuditEntry,
    Base,
    Batch,
    BatchDigest,
    Boot,
    ChainSeal,
    Change,
    ClaimCode,
    DeliveryAttempt,
    Device,
    DeviceRequest,
    DeviceState,
    Diagnosis,
    Erasure,
    Event,
    EventAction,
    GeofencePresence,
    Installation,
    JobAttempt,
    JobFailure,
    MountingRevision,
    Organisation,
    Rerun,
    RerunItem,
    RetentionRule,
    SequenceRun,
    SignInCode,
    TheftWatch,
    TrackPoint,
    Trip,
    User,
    Vehicle,
    ViewTicket,
    WebSession,
)
from server.store import BlobStore, open_store
from tests.conftest import ADMIN_TOKEN

pytestmark = pytest.mark.both_databases
AT = dt.datetime(2026, 3, 1, 12, 0, tzinfo=dt.UTC)
OPEN = re.compile(r"/(healthz|readyz|metrics|openapi\.json|docs|login|static.*|api/v1/auth/.*|api/v1/claim)")


ALERT_IDS = ("alert", "rule", "channel", "delivery", "claim")


def fill(session: Session, store: BlobStore, name: str) -> dict[str, str]:
    """A row of every table for an organisation; ids by the names that routes use."""
    organisation = Organisation(id=f"{name}0" * 16, name=name, created_at=AT - dt.timedelta(days=1))
    ids = {
        kind: f"{name}{number}" * 16
        for number, kind in enumerate(("vehicle", "device", "trip", "user", "key", "request", "event"), 1)
    }
    ids["erasure"] = f"{name}e" * 16
    ids["rerun"] = f"{name}a" * 16
    ids |= {kind: name + letter * 31 for letter, kind in zip("cdefg", ALERT_IDS, strict=True)}
    rest = {kind: f"{name}{number}" * 16 for number, kind in enumerate(("batch", "installation"), 8)}
    ids["analysis"] = f"{name}b" * 16
    org = organisation.id
    columns = Columns({"t": np.array([0.0, 1.0]), **dict.fromkeys(("fx", "fy", "fz"), np.zeros(2))})
    store.put(f"{org}/{name}", columns.to_parquet())
    session.add(organisation)
    session.flush()
    session.add_all(
        [
            Vehicle(
                id=ids["vehicle"], organisation_id=org, name=f"vehicle of {name}", vehicle_class="car", created_at=AT
            ),
            User(
                id=ids["user"], organisation_id=org, email=f"admin@{name}.test", name=name, role="admin", created_at=AT
            ),
        ]
    )
    session.flush()
    session.add(
        Device(
            id=ids["device"],
            organisation_id=org,
            name=f"box of {name}",
            token_hash=name * 64,
            created_at=AT,
            vehicle_id=ids["vehicle"],
        )
    )
    session.flush()
    session.add_all(
        [
            Assignment(device_id=ids["device"], vehicle_id=ids["vehicle"], began_at=AT),
            ApiKey(
                id=ids["key"],
                organisation_id=org,
                name=f"key of {name}",
                key_hash=name * 63 + "k",
                scopes=[],
                created_at=AT,
            ),
            AuditEntry(
                at=AT,
                organisation_id=org,
                actor_kind="job",
                actor_name=name,
                action="a",
                subject=f"of {name}",
                address="",
            ),
            Batch(
                id=rest["batch"],
                organisation_id=org,
                device_id=ids["device"],
                stream="continuous",
                boot="b",
                sequence=0,
                media_type="x",
                body_sha256="",
                column_sha256=columns.column_sha256(),
                blob_key=f"{org}/{name}",
                stored_bytes=0,
                rows=1,
                t_first_s=0.0,
                t_last_s=1.0,
                received_at=AT,
                chain_index=0,
                chain_sha256="",
            ),
            Boot(
                device_id=ids["device"],
                boot="b",
                ordinal=0,
                utc_offset_s=0.0,
                utc_sigma_s=1.0,
                utc_source="gnss",
                arrival_offset_s=0.0,
                t_first_s=0.0,
                t_last_s=1.0,
            ),
            Change(at=AT, organisation_id=org, kind="device", device_id=ids["device"], data={"of": name}),
            ClaimCode(
                code_hash=name * 62 + "cc", device_id=ids["device"], created_at=AT, expires_at=AT + dt.timedelta(1)
            ),
            DeviceRequest(
                id=ids["request"],
                device_id=ids["device"],
                boot="b",
                t_first_s=0.0,
                t_last_s=1.0,
                reason="",
                created_at=AT,
                expires_at=AT + dt.timedelta(days=7),
            ),
            DeviceState(device_id=ids["device"], updated_at=AT, position_at=AT, lat_deg=45.0, lon_deg=11.0),
            Installation(
                id=rest["installation"],
                device_id=ids["device"],
                vehicle_id=ids["vehicle"],
                began_at=AT,
                beginning="first",
                updated_at=AT,
                status="insufficient",
                result=blank_result() | {"reasons": [f"of {name}"]},
                algorithm="x",
                input_sha256="",
            ),
            RetentionRule(
                organisation_id=org, data_class="raw", days=90, applies_at=AT, updated_at=AT, updated_by=f"of {name}"
            ),
            Erasure(
                id=ids["erasure"],
                organisation_id=org,
                subject_kind="vehicle",
                subject_id=ids["vehicle"],
                reason=f"of {name}",
                requested_at=AT,
                requested_by=name,
            ),
            Analysis(
                id=ids["analysis"],
                organisation_id=org,
                creator=f"of {name}",
                kind="allan",
                name=f"file of {name}",
                parameters={},
                created_at=AT,
            ),
            SequenceRun(device_id=ids["device"], stream="continuous", boot="b", first=0, last=0),
            SignInCode(code_hash=name * 62 + "si", organisation_id=org, created_at=AT, expires_at=AT),
            Trip(
                id=ids["trip"],
                organisation_id=org,
                device_id=ids["device"],
                vehicle_id=ids["vehicle"],
                boot="b",
                began_at=AT,
                ended_at=AT,
                t_first_s=0.0,
                t_last_s=1.0,
                distance_m=1.0,
                position_distance_m=1.0,
                moving_s=1.0,
                max_speed_mps=1.0,
                under_way=False,
                algorithm="x",
                input_sha256="",
            ),
            ViewTicket(ticket_hash=name * 62 + "vt", organisation_id=org, device_id=ids["device"], expires_at=AT),
            WebSession(token_hash=name * 62 + "ws", csrf_token="", organisation_id=org, created_at=AT, expires_at=AT),
        ]
    )
    session.flush()
    session.add_all(
        [
            BatchDigest(batch_id=rest["batch"], content=b""),
            MountingRevision(
                installation_id=rest["installation"],
                data_at=AT,
                created_at=AT,
                status="insufficient",
                progress=0.0,
                result={},
                algorithm="x",
                input_sha256="",
            ),
            JobAttempt(device_id=ids["device"], unanswered=1, job_id="j", began_at=AT),
            JobFailure(
                device_id=ids["device"],
                failures=9,
                first_at=AT,
                last_at=AT,
                dead_at=AT,
                error=f"of {name}",
                queue="devices",
                job_id="j",
            ),
            Rerun(id=ids["rerun"], organisation_id=org, created_at=AT, created_by=f"of {name}", algorithm="x", total=1),
            TrackPoint(trip_id=ids["trip"], t_s=0.0, at=AT, lat_deg=45.0, lon_deg=11.0),
            ChainSeal(device_id=ids["device"], chain_length=1, chain_head="", sealed_at=AT),
        ]
    )
    fill_event(session, ids, f"of {name}")
    fill_alert(session, org, ids, f"of {name}")
    return {"organisation": org, **ids}


def fill_alert(session: Session, org: str, ids: dict[str, str], note: str) -> None:
    """An alert with everything around it."""
    own = {"organisation_id": org, "created_at": AT}
    about = {"device_id": ids["device"], "vehicle_id": ids["vehicle"], "event_id": ids["event"]}
    place = {"passage": "left", "fence": note, "position": {"lat_deg": 45.0, "lon_deg": 11.0}}
    session.add_all(
        [
            AlertRule(
                id=ids["rule"],
                name=note,
                kind="crash",
                parameters={"min_delta_v_kmh": 0.0},
                channels=[ids["channel"]],
                cooldown_s=0.0,
                **own,
            ),
            AlertChannel(id=ids["channel"], name=note, kind="webhook", recipients=[note], secret=note, **own),
            Alert(
                id=ids["alert"],
                rule_id=ids["rule"],
                kind="geofence",
                severity="info",
                occurrence=note,
                at=AT,
                facts=place,
                **about,
                **own,
            ),
            TheftWatch(vehicle_id=ids["vehicle"], organisation_id=org, armed_at=AT, armed_by=note),
            AccidentClaim(
                id=ids["claim"],
                vehicle_id=ids["vehicle"],
                reference=note,
                began_at=AT,
                ended_at=AT,
                created_by=note,
                answer={
                    "verdict": "no_data",
                    "says": note,
                    "pulses": [],
                    "bound": None,
                    "covered_share": 0.0,
                    "gaps": [],
                    "boxes": [],
                    "contradictions": [],
                },
                **own,
            ),
            Diagnosis(device_id=ids["device"], name="battery_v", at=AT, value=12.0),
        ]
    )
    session.flush()
    session.add(GeofencePresence(rule_id=ids["rule"], device_id=ids["device"], inside=True, at=AT))
    session.add(
        AlertDelivery(
            id=ids["delivery"],
            alert_id=ids["alert"],
            channel_id=ids["channel"],
            reason="raised",
            priority=1,
            state="dead",
            due_at=AT,
            finished_at=AT,
            error=note,
            **own,
        )
    )
    session.flush()
    session.add(DeliveryAttempt(organisation_id=org, delivery_id=ids["delivery"], number=1, began_at=AT))


def fill_event(session: Session, ids: dict[str, str], note: str) -> None:
    """A crash, and what was said of it."""
    device = session.get_one(Device, ids["device"])
    of_device = {
        model: session.scalars(sa.select(model).where(model.device_id == device.id)).one()
        for model in (Boot, Batch, Installation)
    }
    store_event(
        session,
        crash(0.5),
        device,
        of_device[Boot],
        [of_device[Batch]],
        of_device[Installation],
        id=ids["event"],
        note=note,
    )
    session.add(EventAction(event_id=ids["event"], at=AT, actor=note, action="reopened", note=note))
    session.add(RerunItem(rerun_id=ids["rerun"], event_id=ids["event"], ordinal=0, error=note))


@dataclass
class Tenants:
    database: Database
    mine: dict[str, str]
    theirs: dict[str, str]


@pytest.fixture
def tenants(database, settings) -> Tenants:
    store = open_store(settings)
    with database.transaction() as session:
        # The first is the administrator token's.
        return Tenants(database, fill(session, store, "a"), fill(session, store, "b"))


# --- the wall itself


def test_a_confined_session_sees_one_row_of_every_table(tenants):
    confined = tenants.database.confined_to(tenants.mine["organisation"])
    for mapper in Base.registry.mappers:
        with tenants.database.reading() as session:
            assert len(session.scalars(sa.select(mapper.class_)).all()) == 2, mapper.class_
        with confined.reading() as session:
            rows = session.scalars(sa.select(mapper.class_)).all()
            assert len(rows) == 1, mapper.class_
            if hasattr(rows[0], "organisation_id"):
                assert rows[0].organisation_id == tenants.mine["organisation"]
            # Counts, and columns alone, are no way around.
            assert session.scalar(sa.select(sa.func.count()).select_from(mapper.class_)) == 1, mapper.class_
            assert len(session.execute(sa.select(*mapper.primary_key)).all()) in (1, 2)


def test_a_confined_session_reaches_nothing_by_id_or_by_join(tenants):
    with tenants.database.confined_to(tenants.mine["organisation"]).reading() as session:
        for model, kind in (
            (Vehicle, "vehicle"),
            (Device, "device"),
            (Trip, "trip"),
            (User, "user"),
            (ApiKey, "key"),
            (Event, "event"),
        ):
            assert session.get(model, tenants.mine[kind]) is not None
            assert session.get(model, tenants.theirs[kind]) is None, model
        joined = sa.select(Device.name, Vehicle.name).outerjoin(Vehicle, Vehicle.id != Device.vehicle_id)
        assert session.execute(joined).all() == [("box of a", None)]
        assert session.scalar(sa.select(Organisation.name)) == "a"
        everybody = sa.select(User.email).order_by(User.email).execution_options(**{EVERYWHERE: True})
        assert len(session.scalars(everybody).all()) == 2


def test_a_confined_session_changes_nothing_else(tenants):
    confined = tenants.database.confined_to(tenants.mine["organisation"])
    with confined.transaction() as session:
        session.execute(sa.update(Vehicle).values(name="mine now"))
        session.execute(sa.delete(SequenceRun))
    with tenants.database.reading() as session:
        assert session.get_one(Vehicle, tenants.theirs["vehicle"]).name == "vehicle of b"
        assert session.scalars(sa.select(SequenceRun.device_id)).all() == [tenants.theirs["device"]]
    stray = Vehicle(name="x", organisation_id=tenants.theirs["organisation"], vehicle_class="car", created_at=AT)
    with pytest.raises(NotFoundError), confined.transaction() as session:
        session.add(stray)


# --- every route and method


def api_routes(app: FastAPI) -> list[APIRoute]:
    """Every route of every part; parts are included without a prefix."""
    found: list[APIRoute] = []
    for route in app.routes:
        router = getattr(route, "original_router", None)
        found += [inner for inner in ([route] if router is None else router.routes) if isinstance(inner, APIRoute)]
    assert len(found) > 50
    return found


def routes(app: FastAPI) -> list[tuple[str, str]]:
    return [(method, route.path) for route in api_routes(app) for method in sorted(route.methods)]


def filled(path: str, ids: dict[str, str]) -> str:
    for name in re.findall(r"\{(\w+)\}", path):
        path = path.replace("{" + name + "}", ids.get(name.removesuffix("_id"), "x" * 32))
    return path


def test_without_credentials_every_route_refuses(app, client, tenants):
    for method, path in routes(app):
        if OPEN.fullmatch(path):
            continue
        for ids in (tenants.mine, {}):
            answer = client.request(method, filled(path, ids), json={})
            wanted = 401 if path.startswith("/api/") else 303
            assert answer.status_code == wanted, (method, path, answer.text)


BODIES = {
    "PATCH /api/v1/vehicles/{vehicle_id}": {"name": "taken"},
    "PUT /api/v1/devices/{device_id}/vehicle": {"vehicle_id": None},
    "PUT /api/v1/devices/{device_id}/settings": {"signed_only": True},
    "PUT /api/v1/devices/{device_id}/reference": {"mountings": []},
    "POST /api/v1/devices/{device_id}/requests": {"boot": "b", "t_first_s": 0.0, "t_last_s": 1.0},
    "PUT /api/v1/devices/{device_id}/installation": {"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "reason": "taken over"},
    "PATCH /api/v1/users/{user_id}": {"name": "taken"},
    "POST /users/{user_id}/role": {"role": "reader"},
    "PUT /api/v1/events/{event_id}/review": {"verdict": "confirmed"},
    "PUT /api/v1/events/{event_id}/hold": {"held": True, "reason": "taken over"},
    "POST /api/v1/vehicles/{vehicle_id}/erasure": {"reason": "taken over"},
    "POST /api/v1/users/{user_id}/erasure": {"reason": "taken over"},
    "POST /install/{device_id}/vehicle": {"vehicle_id": "x" * 32},
    "POST /install/{device_id}/level": {"sits": "z-0", "reason": "taken over"},
    "POST /events/{event_id}/review": {"verdict": "confirmed"},
    "POST /devices/{device_id}/installation": {
        "theta": "0",
        "phi": "0",
        "psi": "0",
        "sigma": "1",
        "reason": "taken over",
        "back": "/devices/0",
    },
    "POST /events/{event_id}/hold": {"held": "true", "reason": "taken over"},
    "PUT /api/v1/alert-rules/{rule_id}": {"name": "taken", "condition": {"kind": "crash"}},
    "PUT /api/v1/alert-channels/{channel_id}": {"kind": "webhook", "name": "taken", "url": "https://example.org/"},
    "PUT /api/v1/vehicles/{vehicle_id}/theft": {"armed": True},
    "POST /vehicles/{vehicle_id}/theft": {"armed": "true"},
}
QUERIES = {
    "/api/v1/events/{event_id}/diff": {"before": 1},
    "/events/{event_id}/compare": {"before": 1, "after": 1},
}


def everything(database: Database, own: str) -> dict[str, list[str]]:
    with database.reading() as session:
        return {
            mapper.class_.__name__: sorted(
                str({column.key: getattr(row, column.key) for column in mapper.columns})
                for row in session.scalars(sa.select(mapper.class_))
                if mapper.class_ not in (AuditEntry, WebSession)
                # One's own replay is fetched with a ticket of one's own.
                and not (mapper.class_ is ViewTicket and row.organisation_id == own)
            )
            for mapper in Base.registry.mappers
        }


def test_an_administrator_reaches_nothing_of_another_organisation(app, client, tenants):
    csrf = client.post("/api/v1/auth/session", json={"code": ADMIN_TOKEN}).json()["csrf_token"]
    client.headers["X-CSRF-Token"] = csrf
    own_organisation = tenants.mine["organisation"]
    before = everything(tenants.database, own_organisation)
    tried = 0
    for method, path in routes(app):
        if OPEN.fullmatch(path) or path in ("/logout", "/api/v1/live") or "{ticket}" in path:
            continue
        if "{" not in path:
            if method == "GET":
                answer = client.get(
                    path, params={"device": tenants.theirs["device"], "vehicle": tenants.theirs["vehicle"]}
                )
                # The log, whose newest entries /admin shows too, repeats what this very test asked.
                their_ids = () if "audit" in path or path == "/admin" else tenants.theirs.values()
                for told in ("of b", "b.test", *their_ids):
                    assert told not in answer.text, (path, told)
            continue
        body, query = BODIES.get(f"{method} {path}", {}), QUERIES.get(path)
        sent = {"data": body} if "/api/" not in path else {"json": body}
        answer = client.request(method, filled(path, tenants.theirs), params=query, **sent)
        assert answer.status_code == 404, (method, path, answer.status_code, answer.text)
        tried += 1
        # The same request in one's own organisation is not refused for another reason.
        own = client.request("GET", filled(path, tenants.mine), params=query) if method == "GET" else None
        assert own is None or own.status_code not in (401, 403, 404, 500), (path, own.text)
    assert tried > 25
    assert everything(tenants.database, own_organisation) == before
    # Nor by naming the other's things in a body.
    mine, theirs = tenants.mine, tenants.theirs
    for query in ({"trip": theirs["trip"]}, {"again": theirs["analysis"]}):
        assert client.post("/api/v1/analyses", params={"kind": "allan", **query}).status_code == 404, query
    assert client.get("/workbench", params={"again": theirs["analysis"]}).status_code == 404
    for method, path, body in (
        ("POST", "/api/v1/devices", {"name": "x", "vehicle_id": theirs["vehicle"]}),
        ("PUT", f"/api/v1/devices/{mine['device']}/vehicle", {"vehicle_id": theirs["vehicle"]}),
        (
            "POST",
            "/api/v1/alert-rules",
            {"name": "x", "condition": {"kind": "crash"}, "channels": [theirs["channel"]]},
        ),
        ("POST", f"/install/{mine['device']}/vehicle", {"vehicle_id": theirs["vehicle"]}),
    ):
        assert client.request(method, path, json=body).status_code == 422, path
    for subject in (f"vehicle:{theirs['vehicle']}", f"user:{theirs['user']}"):
        for act in ("plan", "erase"):
            form = {"subject": subject, "reason": "taken over", "act": act}
            assert client.post("/privacy/erasure", data=form).status_code == 404, subject
    window = {"from": AT.isoformat(), "to": (AT + dt.timedelta(hours=1)).isoformat()}
    for path, body in (
        ("/api/v1/alert-rules", {"name": "x", "condition": {"kind": "crash"}, "vehicle_id": theirs["vehicle"]}),
        ("/api/v1/accident-claims", {"vehicle_id": theirs["vehicle"], "reference": "x", **window}),
    ):
        assert client.post(path, json=body).status_code == 404, path
    assert everything(tenants.database, own_organisation) == before


def test_replaying_and_re_running_all_means_ones_own(admin, tenants):
    mine, theirs = tenants.mine, tenants.theirs
    assert [row["device_id"] for row in admin.get("/api/v1/jobs/failures").json()["items"]] == [mine["device"]]
    assert admin.post("/api/v1/jobs/failures/replay").json() == {"replayed": [mine["device"]]}
    begun = admin.post("/api/v1/reruns", json={}).json()
    assert begun["total"] == 1
    with tenants.database.reading() as session:
        assert session.scalars(sa.select(JobFailure.device_id)).all() == [theirs["device"]]
        events = session.scalars(sa.select(RerunItem.event_id).where(RerunItem.rerun_id == begun["id"])).all()
    assert events == [mine["event"]]
    assert admin.post("/api/v1/reruns", json={"device_id": theirs["device"]}).status_code == 404


# --- roles


def test_each_role_does_what_it_may_and_no_more(app, serve, tenants, clock):
    from server.accounts.service import open_session

    wanted = {(method, route.path): _needed(route) for route in api_routes(app) for method in route.methods}
    assert {permission for needed in wanted.values() for permission in needed} == set(PERMISSIONS)
    address = serve(app)
    for role, permissions in ROLE_PERMISSIONS.items():
        with tenants.database.transaction() as session:
            session.execute(sa.update(User).where(User.id == tenants.mine["user"]).values(role=role))
            opened = open_session(session, tenants.mine["organisation"], now=clock(), user_id=tenants.mine["user"])
        with httpx.Client(base_url=address, cookies={"scatola_session": opened.token}) as browser:
            for route in api_routes(app):
                if "GET" not in route.methods or route.path == "/api/v1/live":
                    continue
                needed = wanted["GET", route.path]
                if not needed:
                    continue
                answer = browser.get(filled(route.path, tenants.mine))
                assert (answer.status_code == 403) == (not needed <= permissions), (role, route.path, answer.text)
            for method, path in (
                ("POST", "/api/v1/vehicles"),
                ("POST", "/api/v1/users"),
                ("POST", "/api/v1/organisations"),
                ("PUT", "/api/v1/retention"),
                ("POST", "/api/v1/vehicles/{vehicle_id}/erasure"),
                ("POST", "/api/v1/users/{user_id}/erasure"),
                ("POST", "/privacy/retention"),
                ("POST", "/privacy/erasure"),
                ("PUT", "/api/v1/events/{event_id}/review"),
                ("PUT", "/api/v1/events/{event_id}/hold"),
                ("POST", "/api/v1/events/{event_id}/view-ticket"),
                ("POST", "/api/v1/jobs/failures/replay"),
                ("POST", "/api/v1/reruns"),
                ("POST", "/install/{device_id}/vehicle"),
                ("POST", "/install/{device_id}/level"),
                ("POST", "/events/{event_id}/review"),
                ("POST", "/events/{event_id}/hold"),
                ("POST", "/api/v1/alert-rules"),
                ("POST", "/api/v1/alert-channels"),
                ("POST", "/api/v1/alerts/{alert_id}/acknowledge"),
                ("POST", "/alerts/{alert_id}/acknowledge"),
                ("PUT", "/api/v1/vehicles/{vehicle_id}/theft"),
                ("POST", "/api/v1/alert-deliveries/{delivery_id}/replay"),
                ("POST", "/api/v1/accident-claims"),
                ("POST", "/api/v1/analyses"),
                ("POST", "/api/v1/analyses/{analysis_id}/cancel"),
                ("POST", "/api/v1/alert-channels/{channel_id}/test"),
                ("POST", "/admin/boxes"),
                ("POST", "/admin/boxes/{device_id}/claim-code"),
                ("POST", "/admin/boxes/{device_id}/token"),
                ("POST", "/admin/boxes/{device_id}/settings"),
                ("POST", "/admin/alerts/rules"),
                ("POST", "/admin/alerts/channels"),
                ("POST", "/admin/alerts/channels/{channel_id}/test"),
                ("POST", "/admin/work/replay"),
                ("POST", "/admin/versions"),
            ):
                answer = browser.request(
                    method, filled(path, tenants.mine), json={}, headers={"X-CSRF-Token": opened.csrf_token}
                )
                needed = wanted[method, path]
                refused = path == "/api/v1/organisations" or not needed <= permissions
                assert (answer.status_code == 403) == refused, (role, path)


def _needed(route: APIRoute) -> set[str]:
    """The permissions that a route's dependencies ask for."""
    found: set[str] = set()
    for dependency in route.dependant.dependencies:
        call = dependency.call
        for cell in getattr(call, "__closure__", None) or ():
            if isinstance(cell.cell_contents, str):
                found.add(cell.cell_contents)
    return found


def test_the_permissions_of_a_route_can_be_read_off():
    assert needs("raw.read").__closure__ is not None


def test_who_may_not_locate_sees_places_to_a_kilometre(app, serve, tenants, clock):
    from server.accounts.service import open_session

    with tenants.database.transaction() as session:
        session.execute(sa.update(User).where(User.id == tenants.mine["user"]).values(role="reader"))
        session.execute(sa.update(DeviceState).values(lat_deg=45.4064, lon_deg=11.8768))
        opened = open_session(session, tenants.mine["organisation"], now=clock(), user_id=tenants.mine["user"])
    with httpx.Client(base_url=serve(app), cookies={"scatola_session": opened.token}) as browser:
        for path in ("/", f"/vehicles/{tenants.mine['vehicle']}", f"/devices/{tenants.mine['device']}"):
            page = browser.get(path)
            assert page.status_code == 200
            assert ('data-lat="45.405"' in page.text) == (path != "/"), path
            for word in ("45.4064", "11.8768", "<signal-chart"):
                assert word not in page.text, (path, word)
        for path in ("/fleet/places", "/fleet.csv"):
            told = browser.get(path).text
            assert "45.405" in told, path
            assert "45.4064" not in told, path
        assert "/users" not in browser.get("/").text


@pytest.mark.parametrize("scopes", [["fleet.read"], ["fleet.read", "location.coarse"], ["fleet.read", "location.read"]])
def test_a_key_sees_places_as_well_as_its_scopes_say(admin, address, tenants, scopes):
    with tenants.database.transaction() as session:
        session.add(TrackPoint(trip_id=tenants.mine["trip"], t_s=1.0, at=AT, lat_deg=45.1234, lon_deg=11.5678))
    key = admin.post("/api/v1/api-keys", json={"name": "k", "scopes": scopes}).json()["key"]
    with httpx.Client(base_url=address, headers={"Authorization": f"Bearer {key}"}) as program:
        answer = program.get(f"/api/v1/trips/{tenants.mine['trip']}/track")
        (event,) = program.get("/api/v1/events").json()["items"]
        page, places = program.get("/"), program.get("/fleet/places")
    assert "/privacy" not in page.text
    assert ("<fleet-map" in page.text) == (places.status_code == 200) == (len(scopes) == 2)
    if len(scopes) == 1:
        assert answer.status_code == 403
        assert event["rest"]["lat"] is None
        return
    line = answer.json()["geometry"]["coordinates"]
    exact = "location.read" in scopes
    assert (line == [[11.0, 45.0], [11.5678, 45.1234]]) == exact
    assert (abs(event["rest"]["lat"] - 41.9030) < 1e-6) == exact
    if not exact:
        assert line[1][1] == 45.125
        assert abs(event["rest"]["lat"] - 41.9030) < 0.0051


def test_who_may_not_locate_is_told_of_an_event_with_a_coarse_place(app, serve, tenants, clock):
    from server.accounts.service import open_session

    url = f"/events/{tenants.mine['event']}"
    address = serve(app)
    for role in ("reader", "claims"):
        with tenants.database.transaction() as session:
            session.execute(sa.update(User).where(User.id == tenants.mine["user"]).values(role=role))
            opened = open_session(session, tenants.mine["organisation"], now=clock(), user_id=tenants.mine["user"])
        with httpx.Client(base_url=address, cookies={"scatola_session": opened.token}) as browser:
            (listed,) = browser.get("/api/v1/events").json()["items"]
            one = browser.get(f"/api/v1{url}").json()
            page = browser.get(url)
        assert page.status_code == 200
        for told in (listed, one):
            places = [told["rest"][name] for name in ("lat", "lon")]
            exact = places == pytest.approx([41.9030, 12.4969], abs=1e-6)
            assert exact == (role == "claims")
            assert places == pytest.approx([41.9030, 12.4969], abs=0.01)
            assert told["rest"]["distance_m"] == pytest.approx(11.2)
        for words in (
            "<event-map",
            "<event-charts",
            "<scene-3d",
            "event.json",
            "report.pdf",
            "evidence.zip",
            "/trace?",
        ):
            assert (words in page.text) == (role == "claims"), words
        assert (f'action="{url}/review"' in page.text) == (role == "claims")


def test_who_may_not_locate_is_told_of_an_alert_with_a_coarse_place(app, serve, tenants, clock):
    from server.accounts.service import open_session

    address = serve(app)
    for role in ("reader", "manager"):
        with tenants.database.transaction() as session:
            session.execute(sa.update(User).where(User.id == tenants.mine["user"]).values(role=role))
            opened = open_session(session, tenants.mine["organisation"], now=clock(), user_id=tenants.mine["user"])
        with httpx.Client(base_url=address, cookies={"scatola_session": opened.token}) as browser:
            (listed,) = browser.get("/api/v1/alerts").json()["items"]
            one = browser.get(f"/api/v1/alerts/{tenants.mine['alert']}").json()
            page = browser.get("/alerts").text
        for told in (listed, one):
            position = told["facts"]["position"]
            place = position["lat_deg"], position["lon_deg"]
            assert (place == (45.0, 11.0)) == (role == "manager")
            assert place == pytest.approx((45.0, 11.0), abs=0.01)
            assert told["facts"]["passage"] == "left"
        assert ("45.00000" in page) == (role == "manager")
        assert ("/acknowledge" in page) == (role == "manager")


# --- the audit log


def test_looks_at_events_are_written_down(admin, tenants):
    path, subject = f"/api/v1/events/{tenants.mine['event']}", f"event_id={tenants.mine['event']}"
    for wanted in ("", "/event.json", "/report.pdf", "/scene.viser", "/trace", "/evidence.zip", "/diff?before=1"):
        assert admin.get(path + wanted).status_code in (200, 503), wanted  # no viewer runs
    admin.get(f"{path}/revisions")
    admin.get(f"{path}/edr.json")
    admin.get("/api/v1/events")
    admin.get(f"/events/{tenants.mine['event']}")
    # Their answers hold the place too.
    admin.put(f"{path}/review", json={"verdict": "confirmed"}).raise_for_status()
    admin.put(f"{path}/hold", json={"held": True, "reason": "claim 17"}).raise_for_status()
    with tenants.database.reading() as session:
        query = sa.select(AuditEntry.action, AuditEntry.subject).where(
            AuditEntry.action.in_(("location.read", "raw.read"))
        )
        rows = [tuple(row) for row in session.execute(query.order_by(AuditEntry.id))]
    api = "/api/v1/events/{event_id}"
    assert rows == [
        ("location.read", f"{api} {subject}"),
        ("location.read", f"{api}/event.json {subject}"),
        ("location.read", f"{api}/report.pdf {subject}"),
        ("location.read", f"{api}/scene.viser {subject}"),
        ("raw.read", f"{api}/trace {subject}"),
        ("location.read", f"{api}/trace {subject}"),
        ("raw.read", f"{api}/evidence.zip {subject}"),
        ("location.read", f"{api}/evidence.zip {subject}"),
        ("location.read", f"{api}/diff {subject}"),
        ("location.read", "/api/v1/events"),
        ("location.read", f"/events/{{event_id}} {subject}"),
        ("location.read", f"{api}/review {subject}"),
        ("location.read", f"{api}/hold {subject}"),
    ]


def test_looks_at_places_and_samples_are_written_down(admin, tenants, clock):
    device, trip = tenants.mine["device"], tenants.mine["trip"]
    with tenants.database.reading() as session:
        before = session.scalar(sa.select(sa.func.count(AuditEntry.id)))
    for _ in range(2):
        admin.get(f"/api/v1/trips/{trip}/track")
        admin.get(f"/api/v1/devices/{device}/signals", params={"columns": "fx"})
    admin.get("/")
    admin.get("/api/v1/devices")
    clock.advance(minutes=2)
    admin.get(f"/api/v1/trips/{trip}/track")
    with tenants.database.reading() as session:
        rows = session.scalars(sa.select(AuditEntry).order_by(AuditEntry.id).offset(before)).all()
    assert [(row.action, row.subject) for row in rows] == [
        ("location.read", f"/api/v1/trips/{{trip_id}}/track trip_id={trip}"),
        ("raw.read", f"/api/v1/devices/{{device_id}}/signals device_id={device}"),
        ("location.read", "/"),
        ("location.read", f"/api/v1/trips/{{trip_id}}/track trip_id={trip}"),
    ]
    assert rows[1].detail == {"query": "columns=fx"}
    assert (rows[0].actor_kind, rows[0].actor_name, rows[0].address) == ("admin", "administrator's token", "127.0.0.1")
    shown = admin.get("/api/v1/audit", params={"limit": 3}).json()
    assert len(shown["items"]) == 3
    older = admin.get("/api/v1/audit", params={"before": shown["next"]}).json()
    assert older["next"] is None
    assert "of b" not in str(older)


@pytest.mark.parametrize("statement", ["UPDATE audit_entry SET subject = 'x'", "DELETE FROM audit_entry"])
def test_the_log_only_grows(tenants, statement):
    with pytest.raises(sa.exc.DBAPIError, match="only grows"), tenants.database.transaction() as session:
        session.execute(sa.text(statement))
