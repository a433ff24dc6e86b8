"""Large bodies of the formats that are text."""

from __future__ import annotations

from collections.abc import Callable

from server.formats.columns import NAMES

Shape = Callable[[int], bytes]
_ENDS = {"LF": b"\n", "CR": b"\r", "CRLF": b"\r\n", "CR CR LF": b"\r\r\n", "LF CR": b"\n\r"}
_SOME = {"lat": b"45.5", "lon": b"11.5", "fix": b"1", "ignition": b"0", "hdop": b"1", "sats": b"9", "battery": b"12.5"}


def _filled(pattern: bytes, size: int, begin: bytes = b"", end: bytes = b"") -> bytes:
    room = max(0, size - len(begin) - len(end))
    return begin + pattern * (room // max(1, len(pattern))) + end


def _lines(line: bytes, *, head: bytes = b"") -> dict[str, Shape]:
    """The same line again and again, in every way that lines end, mixed, and without any end."""

    def by(end: bytes) -> Shape:
        return lambda size: _filled(line + end, size, head + (end if head else b""))

    def mixed(size: int) -> bytes:
        ends = list(_ENDS.values())
        block = b"".join(line + end for end in (*ends, *reversed(ends), *ends[::2], *ends[1::2]))
        return _filled(block, size, head + (b"\n" if head else b""))

    def endless(size: int) -> bytes:
        return _filled(line + b" ", size, head + (b"\n" if head else b""))

    return {**{name: by(end) for name, end in _ENDS.items()}, "mixed": mixed, "no end": endless}


def _named(kind: str, shapes: dict[str, Shape]) -> dict[str, Shape]:
    return {f"{kind}, {name}": shape for name, shape in shapes.items()}


def _rows(count: int, columns: int, line: bytes, head: bytes) -> Shape:
    """As many rows as the limit on columns allows."""

    def make(size: int) -> bytes:
        rows = size // (8 * columns) - 2
        return head + line * max(1, rows // count)

    return make


# --- CSV

_ALL = ",".join(NAMES).encode()
_ALL_LINE = b",".join(_SOME.get(name, b"1.25") for name in NAMES)
_LONG = b"0." + b"123456789" * 40
_FORCE = b"t,fx,fy,fz"

_CSV: dict[str, Shape] = {
    **_named("t alone", _lines(b"0", head=b"t")),
    **_named("all columns", _lines(_ALL_LINE, head=_ALL)),
    **_named("nothing but commas", _lines(b"," * (len(NAMES) - 1), head=_ALL)),
    **_named("empty lines", _lines(b"", head=b"t")),
    **_named("quoted", _lines(b'"1.5"', head=b"t")),
    "rows to the limit, t alone": _rows(1, 1, b"1\n", b"t\n"),
    "rows to the limit, CR": _rows(1, 1, b"1\r", b"t\r"),
    "rows to the limit, four columns": _rows(1, 4, b"0.125,9.80665,-0.0125,1.5\n", _FORCE + b"\n"),
    "rows to the limit, all columns": _rows(1, len(NAMES), _ALL_LINE + b"\n", _ALL + b"\n"),
    "rows to the limit, now and then": _rows(
        8, len(NAMES), (b"1" + b"," * (len(NAMES) - 1) + b"\n") * 7 + _ALL_LINE + b"\n", _ALL + b"\n"
    ),
    "rows to the limit, force now and then": lambda size: _FORCE + b"\n" + b"1,,,\n2,1,1,1\n" * (size // 65),
    "rows to the limit, last one bad": lambda size: _FORCE + b"\n" + b"1,1,1,1\n" * (size // 32 - 8) + b"1,x,1,1\n",
    "long numbers": lambda size: _filled(_LONG + b"\n", size, b"t\n"),
    "one number": lambda size: _filled(b"9", size, b"t\n"),
    "one quote": lambda size: _filled(b"1\n", size, b't\n"'),
    "quotes": lambda size: _filled(b'"', size, b"t\n"),
    "a header without end": lambda size: _filled(b"t,", size),
    "wide rows": lambda size: _filled(b",", size, b"t\n"),
    "wide rows, many": lambda size: _filled(b"," * 5000 + b"\n", size, b"t\n"),
    "no UTF-8": lambda size: _filled(b"\xff", size, b"t\n"),
    "NUL": lambda size: _filled(b"\0", size, b"t\n"),
    "NaN": _rows(1, 1, b"nan\n", b"t\n"),
}

# --- JSON


def _json(value: bytes, columns: tuple[bytes, ...] = (b"t",), *, every: bytes = b"") -> Shape:
    """Columns of one value again and again, up to what the size allows as text and as columns."""

    def make(size: int) -> bytes:
        rows = max(1, min(size // 8, size // (len(value) + len(every) + 2)) // len(columns) - 40)
        if every:
            rows //= 2
        listed = b"[" + (value + b"," + (every + b"," if every else b"")) * rows + value + b"]"
        return b'{"columns":{' + b",".join(b'"' + name + b'":' + listed for name in columns) + b"}}"

    return make


def _nested(opening: bytes, closing: bytes, *, closed: bool) -> Shape:
    def make(size: int) -> bytes:
        count = size // (len(opening) + (len(closing) if closed else 0)) - 20
        return b'{"columns":{"t":' + opening * count + (closing * count if closed else b"") + b"}}"

    return make


def _sevenths(size: int) -> bytes:
    """Rows of a drive as boxes send them: positions are null in most rows."""
    rows = size // (8 * 12)
    force = b"[" + b",".join([b"9.80665"] * rows) + b"]"
    some = b"[" + b",".join([b"null"] * (rows - 1)) + b",45.0]"
    names = {b"t": force, **dict.fromkeys((b"fx", b"fy", b"fz", b"wx", b"wy", b"wz"), force)}
    names |= dict.fromkeys((b"lat", b"lon", b"alt", b"speed", b"course"), some)
    return b'{"columns":{' + b",".join(b'"' + name + b'":' + listed for name, listed in names.items()) + b"}}"


_EVERY = tuple(name.encode() for name in NAMES)
_JSON: dict[str, Shape] = {
    "digits": _json(b"1"),
    "floats": _json(b"1.5"),
    "ints beyond 256": _json(b"1000"),
    "nulls": _json(b"null"),
    "floats and nulls": _json(b"1.5", every=b"null"),
    "spaced nulls": _json(b" null"),
    "floats, four columns": _json(b"1.25", (b"t", b"fx", b"fy", b"fz")),
    "floats, all columns": _json(b"1.0", _EVERY),
    "a drive": _sevenths,
    "NaN": _json(b"NaN"),
    "floats and NaN": _json(b"1.5", every=b"NaN"),
    "empty lists": _json(b"[]"),
    "empty objects": _json(b"{}"),
    "objects": _json(b'{"a":1}'),
    "strings": _json(b'"abcdefgh"'),
    "different strings": lambda size: (
        b'{"columns":{"t":[' + b",".join(b'"%x"' % index for index in range(size // 16)) + b"]}}"
    ),
    "strings of nulls": lambda size: (
        b'{"columns":{"t":["' + b",null" * (size // 12) + b'",' + b"1.5," * (size // 12) + b"1]}}"
    ),
    "long numbers": _json(b"9" * 300 + b".5"),
    "numbers beyond floats": _json(b"9" * 400),
    "one number": lambda size: _filled(b"9", size, b'{"columns":{"t":[', b"]}}"),
    "one fraction": lambda size: _filled(b"9", size, b'{"columns":{"t":[0.', b"]}}"),
    "one string": lambda size: _filled(b"a", size, b'{"columns":{"', b'":[]}}'),
    "escapes": lambda size: _filled(b"\\u00e9", size, b'{"columns":{"', b'":[]}}'),
    "deep lists": _nested(b"[", b"]", closed=True),
    "deep lists, open": _nested(b"[", b"]", closed=False),
    "deep objects": _nested(b'{"a":', b"}", closed=True),
    "as deep as is read": lambda size: _filled(b"[" * 900 + b"]" * 900 + b",", size, b'{"columns":{"t":[', b"1]}}"),
    "repeated keys": lambda size: _filled(b'"t":[1],', size, b'{"columns":{', b'"t":[1]}}'),
    "different keys": lambda size: (
        b'{"columns":{' + b",".join(b'"%x":1' % index for index in range(size // 20)) + b"}}"
    ),
    "space": lambda size: _filled(b" ", size, b'{"columns":{"t":[1', b"]}}"),
    "line ends": lambda size: _filled(b"\r\n", size, b'{"columns":{"t":[1', b"]}}"),
    "commas": lambda size: _filled(b",", size, b"["),
}

# --- NMEA and the thesis' line

_GGA = b"$GPGGA,120000.00,4524.6,N,01156.4,E,1,08,1.0,20.0,M,0,M,,"
_SHORT = b"$GPGNS,000000"
_NMEA: dict[str, Shape] = {
    **_named("the same moment", _lines(_GGA)),
    **_named("two bytes", _lines(b"x")),
    **_named("empty lines", _lines(b"")),
    **_named("separators of other texts", _lines(b"\x0b\x0c\x1c\x1d\x1e")),
    "moments": lambda size: b"".join(
        b"$GPGGA,%02d%02d%02d.%02d,4524.6,N,01156.4,E,1,08,1.0,20.0,M,0,M,,\n"
        % (n // 360000 % 24, n // 6000 % 60, n // 100 % 60, n % 100)
        for n in range(size // (4 * 96) - 9)
    ),
    "stamped moments": lambda size: b"".join(
        b"%d.%02d $GPRMC,%02d%02d%02d.%02d,A,4524.6,N,01156.4,E,1.0,20.0,010203,,,A\r"
        % (n // 100, n % 100, n // 360000 % 24, n // 6000 % 60, n // 100 % 60, n % 100)
        for n in range(size // (4 * 96) - 9)
    ),
    "moments, as short as can be": lambda size: b"".join(
        b"$GPGNS,%06d,,,,,,,,\r" % (n % 60) for n in range(size // (4 * 96) - 9)
    ),
    "moments that no time fits": lambda size: _filled(_SHORT + b"\n", size),
    "one sentence": lambda size: _filled(b"1", size, b"$GPGGA,"),
    "blanks before": lambda size: _filled(b" " * 10_000 + b"\n", size),
    "one line of blanks": lambda size: _filled(b" ", size, b"", b"$GPGGA,120000.00,"),
    "separators behind the stamp": lambda size: _filled(b"12" + b" ,;:" * 5000 + b"\n", size),
    "one stamp": lambda size: _filled(b" ", size, b"1", b"$"),
    "digits": lambda size: _filled(b"1" * 5000 + b"\n", size),
    "dollars": lambda size: _filled(b"$", size),
}

_ROW = b"1 10 11.9 45.4 12 36 270 1 1 2 100"
_THESIS: dict[str, Shape] = {
    **_named("rows", _lines(_ROW)),
    **_named("commas", _lines(_ROW.replace(b" ", b","))),
    **_named("short rows", _lines(b"1 1 1 1 1 1 1 1 1 1 1")),
    **_named("empty lines", _lines(b"")),
    "rows to the limit": lambda size: (_ROW + b"\n") * (size // (4 * 88) - 9),
    "rows to the limit, CR": lambda size: (_ROW + b"\r") * (size // (4 * 88) - 9),
    "different rows to the limit": lambda size: b"".join(
        b"%d %d.5 11.%07d 45.%07d 12.25 36.125 270.5 1 1.5 2.5 100.5\n" % (n, n * 10, n, n)
        for n in range(size // (4 * 88) - 9)
    ),
    "one row": lambda size: _filled(b"1 ", size),
    "one number": lambda size: _filled(b"1", size),
    "rows of many fields": lambda size: _filled(b"1 " * 100_000 + b"\n", size),
    "blanks": lambda size: _filled(b" " * 1000 + b"\n", size),
    "long numbers": lambda size: _filled(b" ".join([_LONG] * 11) + b"\n", size),
}

_PHONE_HEAD = b"Time (s),Acceleration x (m/s^2),Acceleration y (m/s^2),Acceleration z (m/s^2)"
_PHONE: dict[str, Shape] = {
    **_named("rows", _lines(b"1.5,1.5,1.5,9.5", head=_PHONE_HEAD)),
    **_named("empty rows", _lines(b"", head=_PHONE_HEAD)),
    "rows to the limit": _rows(1, 4, b"1.5,1.25,1.5,9.5\n", _PHONE_HEAD + b"\n"),
    "semicolons": _rows(1, 4, b"1,5;1,25;1,5;9,5\n", _PHONE_HEAD.replace(b",", b";") + b"\n"),
    "with positions": _rows(
        2, 9, b"1.5,1.5,1.5,9.5,45.5,11.5,12,3,4\n", _PHONE_HEAD + b",latitude,longitude,altitude,speed,bearing\n"
    ),
    "columns that are not taken": lambda size: _filled(
        b"1,1,1,1" + b",1" * 290 + b"\n", size, _PHONE_HEAD + b",x" * 290 + b"\n"
    ),
    "long numbers": lambda size: _filled(_LONG + b",1,1,1\n", size, _PHONE_HEAD + b"\n"),
    "parentheses": lambda size: _filled(b"(", size, b"Time (s),"),
    "blanks in the header": lambda size: _filled(b" ", size, b"Time (s),"),
    "quotes": lambda size: _filled(b'"', size, _PHONE_HEAD + b"\n"),
}

SHAPES: dict[str, dict[str, Shape]] = {
    "text/csv": _CSV,
    "application/json": _JSON,
    "application/vnd.scatola.nmea": _NMEA,
    "application/vnd.scatola.thesis-line": _THESIS,
    "phone": _PHONE,
}
