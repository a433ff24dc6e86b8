"""`scatola upload`: a drive file as a box would send it."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time


def upload(args: argparse.Namespace) -> int:
    """Send every batch of the file; repeating the command sends nothing twice."""
    import httpx

    from server.formats.drive import from_drive, read_drive_file
    from server.uploader import Uploader, batches

    columns = from_drive(read_drive_file(args.drive))
    # The same file gives the same boot, hence the same idempotency keys, however often it is sent.
    boot = args.boot or "file-" + hashlib.sha256(args.drive.read_bytes()).hexdigest()[:16]
    parts = list(batches(columns, args.seconds))
    duplicates = 0
    with httpx.Client(base_url=args.url, timeout=60.0) as client:
        uploader = Uploader(
            client, args.token, boot, wait=time.sleep, say=lambda line: print(f"scatola: {line}", file=sys.stderr)
        )
        for sequence, part in enumerate(parts):
            duplicates += uploader.send(sequence, part).duplicate
            if sys.stderr.isatty():
                print(f"\r{sequence + 1} of {len(parts)} batches", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    result = {"boot": boot, "batches": len(parts), "duplicates": duplicates, "rows": columns.rows}
    print(json.dumps(result) if args.json else f"{len(parts)} batches acknowledged, {duplicates} of them known before")
    return 0
