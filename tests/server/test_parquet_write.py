"""What is written as Parquet, against pyarrow as the reader that did not write it."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.formats import parquet_write
from server.formats.columns import Columns
from server.formats.parquet_check import check
from server.formats.tables import table_of


def stored(columns: Columns) -> bytes:
    """Written, and read back by pyarrow as the same table, bit by bit."""
    content = columns.to_parquet()
    assert check(content, 2**30) == tuple(columns.values)
    file = pq.ParquetFile(io.BytesIO(content))
    assert file.metadata.num_rows == columns.rows
    table = file.read(use_threads=False)
    assert table.equals(table_of(columns))
    back = Columns.from_parquet(content)
    for name, values in columns.values.items():
        np.testing.assert_array_equal(back.values[name].view(np.uint64), values.view(np.uint64))
    return content


def drawn(distinct: int, rows: int) -> np.ndarray:
    rng = np.random.default_rng(distinct)
    return rng.normal(size=distinct)[
        np.concatenate([np.arange(distinct), rng.integers(distinct, size=rows - distinct)])
    ]


@pytest.mark.parametrize("distinct", [1, 255, 256, 257, 5000, 65536, 65537])
def test_few_and_many_different_values(distinct):
    rows = max(1000, 3 * distinct)
    content = stored(Columns({"t": np.arange(rows) / 200.0, "temp": drawn(distinct, rows)}))
    encodings = pq.ParquetFile(io.BytesIO(content)).metadata.row_group(0).column(1).encodings
    assert ("RLE_DICTIONARY" in encodings) == (distinct <= 65536)


@settings(max_examples=100, deadline=None)
@given(
    values=st.lists(st.none() | st.sampled_from([0.0, -0.0, 5e-324, 1.5]) | st.floats(-1e300, 1e300), max_size=40),
    group=st.integers(1, 50),
)
def test_any_rows_in_any_groups(values, group):
    column = np.array(values, dtype=np.float64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parquet_write, "_GROUP_ROWS", group)
        content = stored(Columns({"t": np.arange(column.size) * 1.0, "temp": column, "utc": column}))
    assert pq.ParquetFile(io.BytesIO(content)).metadata.num_row_groups == -(-column.size // group)


def test_the_same_columns_give_the_same_bytes():
    columns = {"t": np.arange(900) / 200.0, "temp": drawn(300, 900)}
    assert Columns(columns).to_parquet() == Columns(dict(columns)).to_parquet()


def test_pandas_is_not_loaded_for_it():
    """It takes half a second, and every full garbage collection longer from then on."""
    script = (
        "import sys, numpy as np\n"
        "from server.formats.columns import Columns\n"
        "Columns({'t': np.arange(9.0), 'temp': np.zeros(9)}).to_parquet()\n"
        "assert 'pandas' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_columns_sampled_together_share_a_mask():
    some = np.where(np.arange(30) % 3 == 0, 1.0, np.nan)
    columns = Columns({"t": np.arange(30.0), "lat": some, "lon": 2.0 * some, "temp": np.roll(some, 1)})
    assert columns.sampled["lat"] is columns.sampled["lon"]
    assert columns.sampled["lat"] is not columns.sampled["temp"]
    for name, values in columns.values.items():
        np.testing.assert_array_equal(columns.samples[name], values[~np.isnan(values)])
    stored(columns)
