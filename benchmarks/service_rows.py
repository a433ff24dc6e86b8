"""The rival: the same uploads, stored as a row per reading by COPY, with no other duty than that.

Two of them: rows handed to the driver one by one, as its documentation shows, and the strongest that we could think of,
which makes COPY's binary form by array code.  A third receives and decodes, and stores nothing: no way of storing can
be faster than that, so it is the ceiling of every ratio.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Generator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import psycopg
import uvicorn
from fastapi import FastAPI, Request
from service_installation import API_CORE, OTHERS, Api, is_ready, start

from server.formats.columns import Columns
from server.formats.decode import decode
from tests.e2e.servers import OwnPostgres
from tests.e2e.service import eventually, free_port

TABLE = (
    """CREATE TABLE reading (device integer, t double precision, fx real, fy real, fz real, PRIMARY KEY (device, t))"""
)
WRITERS = {"row": "COPY row by row", "array": "binary COPY by array code"}
NOTHING = "nothing"
HEAD = b"PGCOPY\n\xff\r\n\x00" + bytes(8)
# A field is its length and its value, big-endian.
_ROW = [("fields", ">i2"), ("l0", ">i4"), ("device", ">i4"), ("l1", ">i4"), ("t", ">f8")]
ROW = np.dtype(_ROW + [each for name in ("fx", "fy", "fz") for each in ((f"l{name}", ">i4"), (name, ">f4"))])


def copied(columns: Columns, device: int) -> bytes:
    """The readings in COPY's binary format, made by array code."""
    kept = ~np.isnan(columns.values["fx"])
    rows = np.zeros(int(kept.sum()), dtype=ROW)
    rows["fields"], rows["device"], rows["l0"], rows["l1"] = 5, device, 4, 8
    for name in ("t", "fx", "fy", "fz"):
        rows[name] = columns.values[name][kept]
        if name != "t":
            rows[f"l{name}"] = 4
    return HEAD + rows.tobytes() + b"\xff\xff"


def app() -> FastAPI:
    """Uploads of compact batches, committed before the answer; a box is known by its token's number."""
    made = FastAPI()
    local: dict[int, psycopg.Connection[tuple[object, ...]]] = {}

    def store(body: bytes, device: int) -> None:
        columns = decode("application/vnd.scatola.batch", body, max_decoded_bytes=2**26)
        if os.environ["ROWS_HOW"] == NOTHING:
            return
        connection = local.get(threading.get_ident())
        if connection is None:
            connection = local[threading.get_ident()] = psycopg.connect(os.environ["ROWS_URL"])
        if os.environ["ROWS_HOW"] == "array":
            with connection.cursor() as cursor, cursor.copy("COPY reading FROM STDIN (FORMAT BINARY)") as copy:
                copy.write(copied(columns, device))
        else:
            kept = ~np.isnan(columns.values["fx"])
            values = [columns.values[name][kept].tolist() for name in ("t", "fx", "fy", "fz")]
            with connection.cursor() as cursor, cursor.copy("COPY reading FROM STDIN") as copy:
                for row in zip(*values, strict=True):
                    copy.write_row((device, *row))
        connection.commit()

    made.state.boxes = 0

    @made.post("/api/v1/devices", status_code=201)
    async def register() -> dict[str, str]:
        made.state.boxes += 1
        return {"id": str(made.state.boxes), "token": str(made.state.boxes)}

    @made.post("/api/v1/batches", status_code=202)
    async def upload(request: Request) -> dict[str, bool]:
        device = int(request.headers["authorization"].removeprefix("Bearer "))
        await asyncio.to_thread(store, await request.body(), device)
        return {"duplicate": False}

    @made.get("/healthz")
    async def healthz() -> dict[str, bool]:
        return {"ok": True}

    return made


@contextlib.contextmanager
def serving(how: str) -> Generator[Api]:
    """The rival on the first core, its PostgreSQL on the others."""
    folder, port = Path(tempfile.mkdtemp(prefix="scatola-bench-")), free_port()
    with contextlib.ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        postgres = stack.enter_context(OwnPostgres(OTHERS))
        url, pid = postgres.url, postgres.process.pid
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute(TABLE)
        environment = {"ROWS_URL": url, "ROWS_PORT": str(port), "ROWS_HOW": how}
        api = Api(folder, port, environment, start([str(Path(__file__).resolve())], environment, API_CORE), url, pid)
        stack.callback(api.stop)
        eventually(lambda: is_ready(api), within_s=60, what="the rival answers")
        yield api


def stored_bytes(api: Api) -> int:
    """Table and index on disk."""
    assert api.database_url is not None
    with psycopg.connect(api.database_url) as connection:
        row = connection.execute("SELECT pg_total_relation_size('reading')").fetchone()
    assert row is not None
    return int(row[0])


if __name__ == "__main__":
    uvicorn.run(app(), host="127.0.0.1", port=int(os.environ["ROWS_PORT"]), log_config=None, access_log=False)
