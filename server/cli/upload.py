"""`scatola upload`: a drive file as a box would send it, through a queue on disk."""

from __future__ import annotations

import argparse
import datetime as dt
import hashlib
import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from server.outbox import Outbox, Tally

_TOKEN = "SCATOLA_DEVICE_TOKEN"  # noqa: S105  the variable's name
_MEGABYTE = 1024 * 1024


def upload(args: argparse.Namespace) -> int:
    """Queue the file's batches, then send all that is queued; repeating the command sends nothing twice."""
    from server.outbox import Outbox

    token = args.token or os.environ.get(_TOKEN)
    if not args.store_only and (args.url is None or not token):
        _misused(f"--url and --token (or {_TOKEN}) are needed to send")
    if args.drive is None and args.store_only:
        _misused("--store-only needs a drive file")
    folder = args.queue or _default_queue(args.url or "", token or "")
    outbox = Outbox(folder, max_bytes=int(args.queue_limit_mb * _MEGABYTE))
    result: dict[str, Any] = {"boot": None, "batches": 0, "rows": 0, "queue": str(folder)}
    if args.drive is not None:
        result |= _queue(args, outbox)
    if args.store_only:
        print(json.dumps(result) if args.json else f"{result['batches']} batches queued in {folder}")
        return 0
    tally = _send(args, token or "", outbox, result)
    if args.json:
        print(json.dumps(result))
    else:
        print(
            f"{tally.acknowledged} batches acknowledged, {tally.duplicates} of them known before;"
            f" {tally.known} more not sent, the service has them"
        )
    for path in tally.refused:
        print(f"scatola: refused, kept in {path} with the reason beside it", file=sys.stderr)
    for boot, ranges in tally.missing.items():
        print(f"scatola: of {boot} the service lacks {ranges}, which are not queued here", file=sys.stderr)
    return 1 if tally.refused else 0


def _misused(why: str) -> NoReturn:
    print(f"scatola upload: {why}", file=sys.stderr)
    raise SystemExit(2)


def _default_queue(url: str, token: str) -> Path:
    """A folder for each box and service."""
    import platformdirs

    name = hashlib.sha256(f"{url}\n{token}".encode()).hexdigest()[:16]
    return Path(platformdirs.user_state_dir("scatola", appauthor=False)) / "outbox" / name


def _queue(args: argparse.Namespace, outbox: Outbox) -> dict[str, Any]:
    from server.formats.drive import from_drive, read_drive_file
    from server.uploader import Parcel, batches, encode

    columns = from_drive(read_drive_file(args.drive))
    # The same file gives the same boot, hence the same idempotency keys, however often it is sent.
    boot = args.boot or "file-" + hashlib.sha256(args.drive.read_bytes()).hexdigest()[:16]
    count = 0
    for part in batches(columns, args.seconds):
        outbox.put(Parcel(args.stream, boot, count, *encode(part, args.encoding)))
        count += 1
    return {"boot": boot, "batches": count, "rows": columns.rows}


def _send(args: argparse.Namespace, token: str, outbox: Outbox, result: dict[str, Any]) -> Tally:
    import httpx

    from server.outbox import Tally, forward
    from server.uploader import Uploader

    tally = Tally()
    with httpx.Client(base_url=args.url, timeout=60.0) as client:
        uploader = Uploader(
            client,
            token,
            "",
            wait=time.sleep,
            say=lambda line: print(f"scatola: {line}", file=sys.stderr),
            patience_s=args.give_up_after,
            sign_as=args.sign_as,
        )
        for tally in forward(outbox, uploader):
            if sys.stderr.isatty():
                print(f"\r{tally.acknowledged + tally.known} batches", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    last = tally.last
    result |= {
        "acknowledged": tally.acknowledged,
        "duplicates": tally.duplicates,
        "known": tally.known,
        "refused": [str(path) for path in tally.refused],
        "missing": tally.missing,
        "requests": [] if last is None else list(last.requests),
        # Good to the length of a request; a box without a clock of its own sets it by this.
        "clock_offset_s": None if last is None else (last.server_time - dt.datetime.now(dt.UTC)).total_seconds(),
    }
    return tally
