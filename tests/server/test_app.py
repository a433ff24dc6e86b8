"""The shell around every route: health, headers, problems, telemetry."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.both_databases


def test_it_is_alive_and_ready(client):
    assert client.get("/healthz").json() == {"status": "ok"}
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["failures"]) == (200, {})


def test_a_batch_goes_in(client, make_device):
    _, token = make_device()
    answer = client.post(
        "/api/v1/batches",
        json={"columns": {"t": [0.0, 0.1], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, None]}},
        headers={"Authorization": f"Bearer {token}", "Idempotency-Key": "a/0"},
    )
    assert answer.status_code == 422, answer.text
    answer = client.post(
        "/api/v1/batches",
        json={"columns": {"t": [0.0, 0.1], "fx": [0, 0], "fy": [0, 0], "fz": [-9.8, -9.7]}},
        headers={"Authorization": f"Bearer {token}", "Idempotency-Key": "a/0"},
    )
    assert answer.status_code == 202, answer.text
    assert answer.json()["next_sequence"] == 1
