"""Log lines: one per event on standard error, as JSON where asked for, with nothing secret in them.

Nothing secret is logged on purpose; what a library's message or an exception's text lets slip is struck out of
the finished line.
"""

from __future__ import annotations

import logging
import re
import sys
from typing import Any

import structlog

# Credentials, wherever they turn up: the password of an address, a bearer's token or signature, our own keys and
# cookies, a query's code, a view's ticket in its path.
_SECRETS = re.compile(
    r"(://[^:/@\s]*:)[^@/\s]+(?=@)"
    r"|(\b(?:bearer|scatola-hmac-sha256)\s+)[^\s\"',\\]+"
    r"|(\bsc[a-z]_)[A-Za-z0-9_-]{8,}"
    r"|(\b(?:scatola_session|code|token|password|secret|csrf_token|signature)=)[^\s&;\"',\\]+"
    r"|(/view3d/)[A-Za-z0-9_-]{16,}",
    re.IGNORECASE,
)


def redact(text: str) -> str:
    """The text with what looks like a credential struck out."""
    return _SECRETS.sub(lambda match: f"{next(filter(None, match.groups()))}[redacted]", text)


def _redacted(logger: object, name: str, line: Any) -> Any:  # structlog's own signature of a processor
    del logger, name
    return redact(line) if isinstance(line, str) else line


def configure_logging(*, as_json: bool, level: str = "info") -> None:
    """One line per event on standard error, of our own and of the libraries that use `logging`."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    render: structlog.typing.Processor = (
        structlog.processors.JSONRenderer()
        if as_json
        else structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
        )
    )
    tail: list[structlog.typing.Processor] = [structlog.processors.format_exc_info] if as_json else []
    structlog.configure(
        # First, or a line that is not wanted is made and then dropped.
        processors=[structlog.stdlib.filter_by_level, *shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=True,
    )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *tail, render, _redacted],
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # Libraries that tell every step of theirs at the level at which we tell of a request.
    for name in ("alembic", "uvicorn", "httpx", "dramatiq", "websockets"):
        logging.getLogger(name).setLevel(logging.WARNING)
    # It warns of every queue that is asked for before anybody made it; what fails is told by who asked.
    logging.getLogger("pika").setLevel(logging.ERROR)
