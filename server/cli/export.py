"""`scatola export`: tracks, events or samples in bulk, as Parquet."""

from __future__ import annotations

import argparse
import datetime as dt
import json
from pathlib import Path

from server.cli.progress import progress
from server.settings import Settings


def export(args: argparse.Namespace) -> int:
    """Write the file; it appears under its name when it is whole."""
    from sqlalchemy import select

    from server.accounts import audit
    from server.accounts.caller import Caller
    from server.bulk.service import Wanted
    from server.bulk.service import export as take
    from server.database import Database
    from server.models import Organisation
    from server.store import open_store

    settings = Settings()
    wanted = Wanted(args.kind, args.device, args.since, args.until)
    database = Database(settings)
    try:
        with database.reading() as session:
            names = {row.id: row.name for row in session.scalars(select(Organisation))}
        chosen = args.organisation or (next(iter(names)) if len(names) == 1 else None)
        if chosen not in names:
            known = ", ".join(f"{name} ({key})" for key, name in names.items())
            raise ValueError(f"--organisation names one of: {known or 'there is none yet'}")
        confined = database.confined_to(chosen)
        with confined.transaction() as session:
            caller = Caller(chosen, "admin", name="command line")
            audit.record(session, caller, "export", args.kind, now=dt.datetime.now(dt.UTC), detail=wanted.told())
        partial = args.out.with_name(args.out.name + ".partial")
        size = 0
        with partial.open("wb") as file:
            for piece in take(confined, open_store(settings), wanted):
                size += file.write(piece)
                progress(f"{size / 1e6:.1f} MB")
        Path(partial).rename(args.out)
    finally:
        database.dispose()
    progress("")
    if args.json:
        print(json.dumps({"kind": args.kind, "file": str(args.out), "bytes": size}))
    else:
        print(f"{args.out}: {size / 1e6:.1f} MB")
    return 0
