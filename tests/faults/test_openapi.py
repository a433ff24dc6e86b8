"""Schemathesis over every operation of the OpenAPI description: no 5xx, and no status or media type not named there.

A few examples each; ``make test-faults`` sets SCATOLA_OPENAPI_EXAMPLES.
"""

from __future__ import annotations

import os

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from schemathesis.specs.openapi.checks import content_type_conformance, status_code_conformance

from server.accounts.gate import DEVICE_PATHS
from tests.conftest import ADMIN_TOKEN

EXAMPLES = int(os.environ.get("SCATOLA_OPENAPI_EXAMPLES", "3"))
# It answers for ever.
ENDLESS = "/api/v1/live"
CHECKS = [status_code_conformance, content_type_conformance]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(120 + 60 * EXAMPLES)]


def attempt(operation: schemathesis.APIOperation, address: str, token: str, session: requests.Session) -> None:
    """Raise when any of the examples is answered as it should not be."""

    @seed(1)
    @settings(max_examples=EXAMPLES, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy())
    def each(case: schemathesis.Case) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        answer = case.call(base_url=address, session=session, headers=headers, timeout=30.0, allow_redirects=False)
        assert answer.status_code < 500, f"{answer.status_code}: {answer.text[:300]}"
        case.validate_response(answer, checks=CHECKS)

    each()


def test_every_operation(app, address, make_device):
    _, token = make_device()
    schema = schemathesis.openapi.from_dict(app.openapi())
    wrong: list[str] = []
    tried = 0
    with requests.Session() as session:
        session.trust_env = False
        for found in schema.get_all_operations():
            operation = found.ok()
            if operation.path == ENDLESS:
                continue
            tried += 1
            try:
                attempt(operation, address, token if operation.path in DEVICE_PATHS else ADMIN_TOKEN, session)
            except (AssertionError, BaseExceptionGroup) as error:
                told = "; ".join(str(one) for one in getattr(error, "exceptions", [error]))
                wrong.append(f"{operation.method.upper()} {operation.path}: {told[:500]}")
    print(f"{tried} operations, {EXAMPLES} examples each")
    assert not wrong, f"{len(wrong)} operations:\n\n" + "\n\n".join(wrong)
