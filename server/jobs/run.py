"""Running one job: its ids in the log, its span, its figures, and what becomes of a failure."""

from __future__ import annotations

import datetime as dt
import time
from collections.abc import Callable

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram

from server.database import Database
from server.jobs.attempts import answered, begin, withdraw
from server.jobs.failures import Job, note_failure, pause_s
from server.tracing import failed, job_span

log = structlog.stdlib.get_logger("scatola.jobs")

# Of the process: a worker has one, and shows it on a port of its own or counts into the API's (`share_figures`).
FIGURES = CollectorRegistry()
JOBS = Counter("scatola_jobs", "Jobs by how they ended", ("queue", "outcome"), registry=FIGURES)
SECONDS = Histogram(
    "scatola_job_seconds",
    "Time of a job",
    ("queue",),
    buckets=(0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0),
    registry=FIGURES,
)
BATCHES = Counter("scatola_job_batches", "Batches worked off", ("outcome",), registry=FIGURES)
ESTIMATES = Counter("scatola_job_estimates", "Mountings estimated", registry=FIGURES)


class Tally:
    """What the rounds of a job did."""

    def __init__(self) -> None:
        self.batches = self.failed = self.estimates = 0

    def add(self, *, batches: int, failed: int, estimates: int) -> None:
        """Count a round."""
        self.batches += batches
        self.failed += failed
        self.estimates += estimates
        BATCHES.labels("done").inc(batches - failed)
        BATCHES.labels("unreadable").inc(failed)
        ESTIMATES.inc(estimates)


def run_job(database: Database, job: Job, work: Callable[[Tally], None], *, clock: Callable[[], dt.datetime]) -> None:
    """Do the work and write down how it went; what it raises is raised on.  Boxes that kill workers are left alone."""
    leave = begin(database, job, clock())
    if not leave.granted:
        JOBS.labels(_label(job), "left alone").inc()
        return
    tally, began, outcome = Tally(), time.perf_counter(), "failed"
    with job_span("bring up to date", job.words, job_id=job.id, device_id=job.device_id, queue=job.queue) as span:
        try:
            work(tally)
            outcome = "done"
            span.set_attribute("scatola.batches", tally.batches)
            answered(database, job.device_id)
        except Exception as error:
            failed(span, type(error).__name__)
            _fail(database, job, error, clock())
            raise
        except BaseException:
            if leave.written:
                _withdraw(database, job)
            raise
        finally:
            seconds = time.perf_counter() - began
            queue = _label(job)
            JOBS.labels(queue, outcome).inc()
            SECONDS.labels(queue).observe(seconds)
            if outcome == "done":
                # A look that found nothing to do is nobody's news.
                say = log.info if tally.batches else log.debug
                say("job", queue=queue, batches=tally.batches, unreadable=tally.failed, ms=round(seconds * 1e3, 1))


def _label(job: Job) -> str:
    return "bursts" if job.queue.endswith("bursts") else "devices"


def _withdraw(database: Database, job: Job) -> None:
    try:
        withdraw(database, job.device_id)
    except Exception:
        log.exception("attempt cannot be withdrawn", device_id=job.device_id)


def _fail(database: Database, job: Job, error: Exception, now: dt.datetime) -> None:
    try:
        with database.transaction() as session:
            row = note_failure(session, job, error, now=now)
        count = 1 if row is None else row.failures
    except Exception:
        # The database may be why the job failed; what is due stays due all the same.
        log.exception("failure cannot be written down", device_id=job.device_id)
        count = 1
    log.error("work failed", failures=count, again_in_s=pause_s(count), exc_info=error)
