"""`scatola dead-letters`: boxes whose work keeps failing, and trying them again."""

from __future__ import annotations

import argparse
import json

from server.settings import Settings


def dead_letters(args: argparse.Namespace) -> int:
    """List what fails, or replay it; status 0 whatever there is."""
    from server.database import Database
    from server.jobs.failures import dead, failing, forget

    settings = Settings()
    database = Database(settings)
    try:
        replayed: list[str] = []
        if args.replay or args.replay_all:
            with database.transaction() as session:
                replayed = forget(session, sorted(dead(session)) if args.replay_all else args.replay)
            unknown = sorted(set(args.replay or ()) - set(replayed))
            if unknown:
                raise ValueError(f"no work of {', '.join(unknown)} fails")
            _tell_broker(settings, replayed)
        with database.reading() as session:
            found = failing(session)
    finally:
        database.dispose()
    if args.json:
        rows = [
            {
                "device_id": each.failure.device_id,
                "device_name": each.name,
                "dead": each.failure.dead_at is not None,
                "failures": each.failure.failures,
                "first_at": each.failure.first_at.isoformat(),
                "last_at": each.failure.last_at.isoformat(),
                "error": each.failure.error,
                "job_id": each.failure.job_id,
                "request_id": each.failure.request_id,
                "waiting_batches": each.waiting,
            }
            for each in found
        ]
        print(json.dumps({"replayed": replayed, "failing": rows}))
        return 0
    for device_id in replayed:
        print(f"tried again now: {device_id}")
    for each in found:
        row = each.failure
        word = "dead   " if row.dead_at is not None else "failing"
        print(f"{word}  {row.device_id}  {each.name}: {row.failures} times since {row.first_at:%Y-%m-%d %H:%M:%S} UTC,")
        print(f"         {each.waiting} batches wait; {row.error}")
    if not found:
        print("no work fails")
    return 0


def _tell_broker(settings: Settings, device_ids: list[str]) -> None:
    """Without a broker the worker sees by itself that nothing holds the boxes back."""
    if settings.broker_url is None or not device_ids:
        return
    from server.jobs.broker import QUEUE, BrokerUnreachableError, Queues, make_broker, message_for

    try:
        Queues(settings).drop_letters(set(device_ids))
    except BrokerUnreachableError as error:
        raise ValueError(f"the broker does not answer ({error}); the workers' sweep sends the boxes later") from error
    broker = make_broker(settings.broker_url.get_secret_value())
    broker.declare_queue(QUEUE)
    for device_id in device_ids:
        broker.enqueue(message_for(device_id, QUEUE))
    broker.close()
