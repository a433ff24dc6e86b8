"""`scatola reprocess`: events again, by this version."""

from __future__ import annotations

import argparse
import dataclasses
import datetime as dt
import json

from server.settings import Settings, set_numba_cache_dir


def reprocess(args: argparse.Namespace) -> int:
    """Compute severe events again from their inputs and say what changed."""
    set_numba_cache_dir()
    from server.database import Database
    from server.jobs.reprocess import reprocess as again
    from server.jobs.reprocess import severe_events
    from server.store import open_store

    settings = Settings()
    database = Database(settings)
    try:
        store = open_store(settings)
        results = [
            again(database, store, event_id, clock=lambda: dt.datetime.now(dt.UTC))
            for event_id in severe_events(database, args.device)
        ]
    finally:
        database.dispose()
    if args.json:
        print(json.dumps({"events": [dataclasses.asdict(each) for each in results]}))
        return 0
    for each in results:
        print(f"{each.event_id}  revision {each.revision}  {each.before_algorithm} -> {each.algorithm}  {each.outcome}")
        for path in each.differences:
            print(f"    {path}")
    return 0
