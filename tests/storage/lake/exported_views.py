"""Every view of a store as files, and the comparison of two such exports."""

from pathlib import Path

from storage.sql.catalog import Catalog
from storage.store import Store
from tests.storage.conftest import DAY_NS, START_NS

LATER_NS = START_NS + 30 * DAY_NS
TABLES = ("samples", "signals", "runs", "steps", "estimates", "events", "rollup_1s", "rollup_10s", "clocks")


def export(store: Store, folder: Path) -> None:
    """Every view as a Parquet file."""
    import pyarrow.parquet as pq

    folder.mkdir()
    with Catalog(store) as catalog:
        for table in TABLES:
            pq.write_table(catalog.reader(f"select * from {table}").read_all(), folder / f"{table}.parquet")


def assert_same(a: Path, b: Path) -> None:
    import duckdb

    for table in TABLES:
        for one, other in ((a, b), (b, a)):
            sql = f"select * from '{one}/{table}.parquet' except all select * from '{other}/{table}.parquet'"
            found = duckdb.sql(sql)
            assert found is not None
            assert found.fetchall() == [], table
