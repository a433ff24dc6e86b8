"""`scatola demo`: the service as `serve` runs it, and a simulated fleet that uploads to it."""

from __future__ import annotations

import argparse
import datetime as dt
import os
import secrets
import signal
import threading
import time

import platformdirs

from server.settings import Settings, set_numba_cache_dir, share_figures


def demo(args: argparse.Namespace) -> int:
    """Serve, with the fleet as one more supervised child."""
    share_figures()
    from server.accounts.service import ensure_organisation, new_sign_in_code
    from server.cli.processes import say
    from server.database import Database
    from server.jobs.supervise import Child, scatola
    from server.serve import serve

    # A folder of its own: who tries the demo and then serves in earnest does not find toys among his vehicles.
    # The children read the same environment.
    os.environ.setdefault("SCATOLA_DATA_DIR", str(platformdirs.user_data_path("scatola", appauthor=False) / "demo"))
    os.environ.setdefault("SCATOLA_ADMIN_TOKEN", secrets.token_urlsafe(32))
    os.environ.setdefault("SCATOLA_LOG_LEVEL", "warning")
    os.environ.pop("SCATOLA_BROKER_URL", None)

    def fleet_child(url: str) -> list[Child]:
        arguments = ["--url", url, "--speed", str(args.speed), "--history-minutes", str(args.history_minutes)]
        return [Child("fleet", scatola("demo-fleet", *arguments))]

    def sign_in(database: Database) -> str:
        now = dt.datetime.now(dt.UTC)
        with database.transaction() as session:
            return new_sign_in_code(session, ensure_organisation(session, now=now).id, now=now)

    settings = Settings()
    say(f"Nine simulated boxes upload to a service on this machine; its data is in {settings.data_dir}")
    serve(settings, say=say, more_children=fleet_child, sign_in=sign_in)
    return 0


def fleet(args: argparse.Namespace) -> int:
    """The fleet alone; started by `demo`, stopped by it or with it."""
    set_numba_cache_dir()
    import httpx

    from server.demo.fleet import Fleet, Memory, Timeline
    from server.jobs.supervise import follow_parent

    os.nice(3)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: stop.set())
    follow_parent(stop.set)
    settings = Settings()
    if settings.admin_token is None:
        raise ValueError("SCATOLA_ADMIN_TOKEN is not set: the fleet registers its boxes with it")
    started = time.time()
    replay = Timeline(started=started, history_s=60.0 * args.history_minutes, speed=args.speed, now=time.time)
    life = Timeline(started=started, history_s=0.0, speed=1.0, now=time.time)
    with httpx.Client(base_url=args.url, timeout=30.0, trust_env=False) as client:
        Fleet(
            client,
            settings.admin_token.get_secret_value(),
            Memory(settings.data_dir / "demo.json"),
            lambda box: life if box.begins_now else replay,
            stop,
        ).run()
    # A fleet that came to its end must not be started again at once.
    stop.wait()
    return 0
