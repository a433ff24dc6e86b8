"""`scatola backup` and `scatola restore`."""

from __future__ import annotations

import argparse
import datetime as dt
import json
import sys
from typing import TYPE_CHECKING

from server.cli.progress import progress
from server.settings import Settings

if TYPE_CHECKING:
    from server.backup.archive import Report


def backup(args: argparse.Namespace) -> int:
    """Status 1 where blobs are lost: the backup holds all the rest."""
    from server.backup.archive import backup as take

    report = take(Settings(), args.out, now=dt.datetime.now(dt.UTC), say=progress)
    progress("")
    _show(args, report, f"backed up into {args.out}")
    for key in report.lost_blobs[:20]:
        print(f"scatola: blob {key} is lost, `scatola verify` tells whose", file=sys.stderr)
    return 1 if report.lost_blobs else 0


def restore(args: argparse.Namespace) -> int:
    """Rows and blobs, then this version's migrations."""
    from server.backup.archive import restore as bring
    from server.migrations import upgrade

    settings = Settings()
    report = bring(settings, args.source, say=progress)
    upgrade(settings)
    progress("")
    _show(args, report, f"restored from {args.source}")
    return 0


def _show(args: argparse.Namespace, report: Report, did: str) -> None:
    rows = sum(told["rows"] for told in report.tables.values())
    if args.json:
        print(
            json.dumps(
                {
                    "revision": report.revision,
                    "rows": rows,
                    "tables": {name: told["rows"] for name, told in report.tables.items()},
                    "blobs": report.blobs["count"],
                    "blob_bytes": report.blobs["bytes"],
                    "lost_blobs": report.lost_blobs,
                    "erased_blobs": report.erased_blobs,
                    "content_sha256": report.content_sha256,
                }
            )
        )
        return
    size = f"{report.blobs['bytes'] / 1e6:.1f} MB"
    print(f"{did}: {rows} rows, {report.blobs['count']} blobs of {size}, revision {report.revision}")
    print(f"content {report.content_sha256}")
