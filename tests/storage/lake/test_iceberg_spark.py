"""The files of the Iceberg tables as Spark reads them: counts, sums, least and greatest per unit and signal.

Spark reads the same Parquet files, as the tables list them: its own reader of Iceberg is a library of Java that is not
on PyPI.
"""

import shutil
from importlib.util import find_spec
from pathlib import Path

import duckdb
import pytest
from pyiceberg.catalog.sql import SqlCatalog

from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.iceberg_export import export_iceberg
from storage.lake.lake import Lake
from tests.storage.conftest import Filler
from tests.storage.lake.exported_views import LATER_NS

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_spec("pyspark") is None, reason="PySpark is not installed"),
    pytest.mark.skipif(shutil.which("java") is None, reason="there is no Java here"),
]
SAMPLES = """
select c.unit, c.signal, count(*) as n, sum(cast(s.base as bigint) + s.above) as total, min(s.t_ns) as first_ns,
  max(s.t_ns) as last_ns, min(s.base + s.above) as lo, max(s.base + s.above) as hi, sum(s.flags) as flags
from samples s join (select distinct channel, unit, signal from channels) c on c.channel = s.channel
group by c.unit, c.signal order by c.unit, c.signal
"""
SECONDS = """
select c.unit, c.signal, count(*) as buckets, sum(r.n) as n, min(r.bucket) as first, max(r.bucket) as last,
  min(r.lo) as lo, max(r.hi) as hi, min(r.mean) as least, max(r.mean) as most, max(r.m2) as most_m2
from rollup_1s r join (select distinct channel, unit, signal from channels) c on c.channel = r.channel
group by c.unit, c.signal order by c.unit, c.signal
"""


def test_spark_reads_the_same_numbers(days: Filler, tmp_path: Path) -> None:
    from pyspark.sql import SparkSession

    days.build()
    with builder_lock(days.store):
        list(compact(Lake(days.store), now_ns=LATER_NS))
    export_iceberg(days.store, tmp_path / "W")
    catalog = SqlCatalog("gyrofleet", uri=f"sqlite:///{tmp_path / 'W' / 'catalog.db'}")
    spark = SparkSession.builder.master("local[1]").config("spark.ui.enabled", "false").getOrCreate()
    try:
        for name in ("samples", "channels", "rollup_1s"):
            files = [each.file.file_path for each in catalog.load_table(f"gyrofleet.{name}").scan().plan_files()]
            spark.read.parquet(*files).createOrReplaceTempView(name)
            duckdb.from_parquet([each.removeprefix("file://") for each in files]).create_view(name)
        for sql in (SAMPLES, SECONDS):
            theirs = [tuple(row) for row in spark.sql(sql).collect()]
            assert theirs == duckdb.execute(sql).fetchall()
            assert [row[:2] for row in theirs] == [("U1", "rate"), ("U1", "temperature")]
        assert [row[2] for row in spark.sql(SAMPLES).collect()] == [30_000, 300]
    finally:
        spark.stop()
