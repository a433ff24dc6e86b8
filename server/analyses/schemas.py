"""What the API says of analyses."""

from __future__ import annotations

import datetime as dt
from typing import Any, Literal, cast

from pydantic import BaseModel

from server.analyses.kinds import Kind
from server.models import Analysis

Status = Literal["waiting", "running", "done", "failed", "cancelled"]


class AnalysisOut(BaseModel):
    """One analysis."""

    id: str
    kind: Kind
    name: str
    creator: str
    device_id: str | None
    input_bytes: int
    input_sha256: str
    parameters: dict[str, Any]
    status: Status
    progress: float
    stage: str
    attempts: int
    created_at: dt.datetime
    finished_at: dt.datetime | None
    algorithm: str
    result_sha256: str | None
    error: str | None

    @classmethod
    def of(cls, row: Analysis) -> AnalysisOut:
        """From the row."""
        return cls(
            id=row.id,
            kind=cast("Kind", row.kind),
            name=row.name,
            creator=row.creator,
            device_id=row.device_id,
            input_bytes=row.input_bytes,
            input_sha256=row.input_sha256,
            parameters=row.parameters,
            status=cast("Status", row.status),
            progress=row.progress,
            stage=row.stage,
            attempts=row.attempts,
            created_at=row.created_at,
            finished_at=row.finished_at,
            algorithm=row.algorithm,
            result_sha256=row.result_sha256,
            error=row.error,
        )


class AnalysisList(BaseModel):
    """Analyses, the newest first."""

    items: list[AnalysisOut]
