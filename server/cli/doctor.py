"""`scatola doctor`."""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import json

from server.settings import Settings

_MARKS = {"ok": "ok     ", "warning": "WARNING", "fault": "FAULT  "}


def doctor(args: argparse.Namespace) -> int:
    """Status 1 when there is a fault; warnings alone are status 0."""
    settings = Settings()
    from server.operations.doctor import Doctor

    found = []
    for finding in Doctor(settings, dt.datetime.now(dt.UTC)).findings():
        found.append(finding)
        if not args.json:
            print(f"{_MARKS[finding.status]}  {finding.check}: {finding.detail}", flush=True)
    healthy = not any(finding.status == "fault" for finding in found)
    if args.json:
        print(json.dumps({"healthy": healthy, "findings": [dataclasses.asdict(finding) for finding in found]}))
    return 0 if healthy else 1
