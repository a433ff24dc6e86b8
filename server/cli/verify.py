"""`scatola verify`: the chain of evidence of boxes, or an archive of evidence."""

from __future__ import annotations

import argparse
import json
import sys
import zipfile
from typing import Any


def verify(args: argparse.Namespace) -> int:
    """Status 0 when everything holds, 1 when something does not."""
    return _archive(args) if args.archive is not None else _boxes(args)


def _archive(args: argparse.Namespace) -> int:
    from server.evidence.verify import check_zip

    if not zipfile.is_zipfile(args.archive):
        args.archive.stat()  # a missing file is not one that was tampered with
        raise ValueError(f"{args.archive} is no archive of evidence: not a zip file")
    report = check_zip(args.archive, args.key)
    if args.json:
        print(json.dumps({"passed": report.passed, "checks": report.lines, "limits": report.limits}))
    else:
        for line in report.lines:
            print(f"{'ok   ' if line['passed'] else 'WRONG'}  {line['check']}: {line['detail']}")
        for limit in report.limits:
            print(f"note   {limit}")
    if not report.passed:
        print(f"scatola: {args.archive} does not hold", file=sys.stderr)
    return 0 if report.passed else 1


def _boxes(args: argparse.Namespace) -> int:
    from server.database import Database
    from server.evidence.audit import audit, devices
    from server.settings import Settings
    from server.store import open_store

    settings = Settings()
    root = None if settings.timestamp_root_file is None else settings.timestamp_root_file.read_bytes()
    database = Database(settings)
    try:
        found = devices(database, args.device)
        if args.device is not None and not found:
            raise ValueError(f"there is no box {args.device}")
        store = open_store(settings)
        audits = [audit(database, store, device_id, root_pem=root) for device_id in found]
    finally:
        database.dispose()
    passed = all(each.passed for each in audits)
    if args.json:
        told: list[dict[str, Any]] = [
            {
                "device_id": each.device_id,
                "name": each.name,
                "passed": each.passed,
                "links": each.links,
                "revisions": each.revisions,
                "seals": each.seals,
                "erased_links": each.erased_links,
                "erased_revisions": each.erased_revisions,
                "faults": each.faults,
            }
            for each in audits
        ]
        print(json.dumps({"passed": passed, "devices": told}))
    else:
        for each in audits:
            counts = f"{each.links} links, {each.seals} seals, {each.revisions} revisions of events"
            if each.erased_links or each.erased_revisions:
                counts += f"; erased: raw data of {each.erased_links} links, {each.erased_revisions} revisions"
            print(f"{'ok   ' if each.passed else 'WRONG'}  {each.name}: {counts}")
            for fault in each.faults:
                print(f"       {fault}")
    if not passed:
        print("scatola: the chain of evidence does not hold", file=sys.stderr)
    return 0 if passed else 1
