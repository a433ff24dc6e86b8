"""Lines of a text that anybody may have sent, measured before they are made.

CR ends a line as well as LF does, whatever a reader makes of it.
"""

from __future__ import annotations

from server.errors import InvalidError

MAX_LINE_BYTES = 64 * 1024


def lines_of(body: bytes) -> int:
    """How many lines a text has at most, counted without making them."""
    return body.count(b"\n") + body.count(b"\r") - body.count(b"\r\n") + 1


def first_line(body: bytes, most: int) -> bytes:
    """The first line without its end, cut after so many bytes."""
    line = body[:most]
    ends = [at for end in (b"\n", b"\r") if (at := line.find(end)) >= 0]
    return line[: min(ends)] if ends else line


def check_lines(body: bytes, code: str) -> None:
    """Raise where a line is longer than any row: a reader would make many times its length of it, or quote it."""
    begin = 0
    while len(body) - begin > MAX_LINE_BYTES:
        end = begin + MAX_LINE_BYTES + 1
        # Most texts have ends of one kind; the other is looked for where that one is missing.
        last = body.rfind(b"\n", begin, end)
        last = last if last >= 0 else body.rfind(b"\r", begin, end)
        if last < 0:
            row = lines_of(body[:begin])
            raise InvalidError(f"Line {row} is longer than {MAX_LINE_BYTES} bytes", code=code, row=row)
        begin = last + 1
