"""Pages of Parquet files are measured before they are decoded."""

from collections.abc import Callable
from pathlib import Path

import duckdb
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ingest.tables import parquet_pages
from ingest.tables.parquet_chunks import ParquetTable
from stream.errors import BadInput

ROWS = 60_000
TABLE = pa.table(
    {
        "time[s]": np.arange(ROWS) / 100,
        "rate[deg/h]": np.random.default_rng(1).normal(size=ROWS),
        "step": [f"step {i % 3000}" * 9 for i in range(ROWS)],
    }
)


def by_duckdb(path: Path) -> None:
    with duckdb.connect() as connection:
        connection.register("rows", TABLE)
        connection.execute(f"copy rows to '{path}' (format parquet, row_group_size 20000)")


WRITERS: dict[str, Callable[[Path], None]] = {
    "usual": lambda path: pq.write_table(TABLE, path),
    "second version": lambda path: pq.write_table(TABLE, path, data_page_version="2.0", compression="zstd"),
    "plain": lambda path: pq.write_table(TABLE, path, use_dictionary=False, compression="none", row_group_size=7000),
    "duckdb": by_duckdb,
    "polars": lambda path: pl.DataFrame(TABLE).write_parquet(path),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_all_pages_of_each_writer_are_measured(tmp_path: Path, writer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "table.parquet"
    WRITERS[writer](path)
    metadata = pq.ParquetFile(path).metadata
    groups = [metadata.row_group(at) for at in range(metadata.num_row_groups)]
    columns = [group.column(place) for group in groups for place in range(group.num_columns)]
    found = 0
    with path.open("rb") as file:
        for column in columns:
            begin = column.data_page_offset
            if column.has_dictionary_page:
                begin = column.dictionary_page_offset
            sizes = list(parquet_pages._page_sizes(file, begin, begin + column.total_compressed_size))
            headers = column.total_uncompressed_size - sum(sizes)
            assert 0 < headers < 600 * len(sizes)
            found = max(found, *sizes)
    ParquetTable(path)
    monkeypatch.setattr(parquet_pages, "MAX_PAGE_BYTES", found - 1)
    with pytest.raises(BadInput, match=f"claims {found:,} bytes"):
        ParquetTable(path)
