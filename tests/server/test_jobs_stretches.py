"""How new batches are put together for the search for events."""

from __future__ import annotations

import pytest

from server.jobs.events import STRETCH_ROWS, stretches_of
from server.models import Batch


def _batch(boot: str, first_s: float, rows: int) -> Batch:
    return Batch(boot=boot, t_first_s=first_s, t_last_s=first_s + 300.0, rows=rows)


@pytest.mark.parametrize(("rows", "pieces"), [(STRETCH_ROWS // 4, 1), (STRETCH_ROWS // 2, 2), (2 * STRETCH_ROWS, 4)])
def test_batches_that_touch_are_one_piece_up_to_a_number_of_rows(rows: int, pieces: int):
    found = stretches_of([_batch("b", 300.0 * k, rows) for k in (2, 0, 3, 1)])
    assert len(found) == pieces
    assert (found[0][1], found[-1][2]) == (0.0, 1200.0)


def test_a_gap_and_another_boot_begin_a_piece():
    found = stretches_of([_batch("a", 0.0, 10), _batch("a", 400.0, 10), _batch("b", 700.0, 10)])
    assert found == [("a", 0.0, 300.0), ("a", 400.0, 700.0), ("b", 700.0, 1000.0)]
