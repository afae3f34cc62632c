"""A standalone master of Spark with two workers on loopback, of which one is killed in the middle of the work."""

import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from analytics.cluster.diagnosis_tasks import ClusterTracing
from analytics.cluster.metric_tasks import ClusterComputation, RecordsTask, compute_records
from analytics.cluster.store_slice import sliced
from analytics.evaluation.kept_metrics import unit_metrics
from analytics.loop.unit_diagnosis import trace_units
from analytics.loop.unit_reduction import Question, reduce_units
from storage.sql.catalog import Catalog
from stream.errors import GyrofleetError
from tests.analytics.cluster.several_units import computed, fill
from tests.bench.spark_cluster import StandaloneCluster

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        find_spec("pyspark") is None, reason="PySpark is not installed (pip install 'gyrofleet[spark]')"
    ),
    pytest.mark.skipif(shutil.which("java") is None, reason="there is no Java here"),
]
UNITS = tuple(f"FOG-{number}" for number in range(8))


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[StandaloneCluster]:
    with StandaloneCluster(tmp_path / "cluster", workers=2) as started:
        yield started


def test_a_worker_that_is_killed_changes_no_result(tested: Any, cluster: StandaloneCluster, tmp_path: Path) -> None:
    from analytics.cluster.spark import SparkEngine

    fill(tested, units=UNITS)
    tested.catalog().close()
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    steps, metrics = computed(tested.store, here)
    question = Question("rate = bias")
    with Catalog(tested.store) as catalog:
        read = reduce_units(catalog, UNITS, question)
    whole = trace_units(read, question, is_pooled=True).fleet
    assert whole is not None
    killed: list[int] = []

    def kill_in_the_middle(done: int, total: int) -> None:
        if not killed and 0 < done < total:
            killed.append(done)
            cluster.kill_worker()

    with SparkEngine(cluster.engine) as engine:
        assert engine.slots == 2
        with Catalog(tested.store, kept=there) as catalog, catalog.suspended_layers():
            unit_metrics(catalog, computation=ClusterComputation(engine, kill_in_the_middle))
            assert steps.equals(catalog.stored("step_means"))
            found = catalog.stored("unit_metrics")
        assert killed
        assert metrics.equals(found)
        tracing = ClusterTracing(engine, lambda _done, _total: None, lambda _done, _total: None)
        with Catalog(tested.store) as catalog:
            read = reduce_units(catalog, UNITS, question, read=tracing.read)
        traced = trace_units(read, question, is_pooled=True, spread=tracing.spread).fleet
    assert traced is not None
    assert whole.document() == traced.document()


def test_a_store_that_a_worker_does_not_see_is_named_with_the_worker(tested: Any, cluster: StandaloneCluster) -> None:
    from analytics.cluster.spark import SparkEngine

    fill(tested, runs=1)
    tested.catalog().close()
    with SparkEngine(cluster.engine) as engine:
        with Catalog(tested.store) as catalog:
            tasks = [RecordsTask(each, {"r0": "print"}) for each in sliced(catalog, UNITS[:3], engine.slots)]
        moved = tested.store.folder.rename(tested.store.folder.with_name("moved"))
        try:
            with pytest.raises(GyrofleetError, match=r"a task failed on .*store is not a gyrofleet store"):
                engine.map(compute_records, tasks, [len(each.of.units) for each in tasks], lambda _done, _total: None)
        finally:
            moved.rename(tested.store.folder)
