"""The option --engine: what is not kept is computed by Spark, on this machine or on a cluster."""

import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from stream.errors import BadInput, StoreError
from stream.terminal.console import counted, status_line

if TYPE_CHECKING:
    from analytics.cluster.diagnosis_tasks import ClusterTracing
    from analytics.cluster.engine import Done, Engine
    from storage.sql.catalog import Catalog

engine_option = click.option(
    "--engine", metavar="local[N]|spark://HOST:PORT",
    help="Compute by Apache Spark, with the same result: on N processors of this machine, or on a cluster that sees "
    "the store at the same path. Needs pip install 'gyrofleet[spark]' and Java 17.",
)  # fmt: skip


@contextmanager
def opened_engine(name: str, report: Callable[[str], None]) -> "Iterator[Engine]":
    """A Spark session as long as it is needed."""
    from analytics.cluster.engine import check_engine

    check_engine(name)  # before what needs Spark is imported
    from analytics.cluster.spark import SparkEngine

    report(f"starting Spark ({name})")
    with SparkEngine(name) as engine:
        report(f"{name} runs {counted(engine.slots, 'task')} at a time")
        yield engine


def compute_by_engine(catalog: "Catalog", name: str | None, wanted: Collection[str] = ()) -> None:
    """Compute the metrics of units that changed by an engine, and keep them in the store, where commands find them.

    Nothing without an engine.
    """
    if name is None:
        return
    from analytics.cluster.metric_tasks import ClusterComputation
    from analytics.evaluation.kept_metrics import unit_metrics
    from analytics.metric_registry.registry import check_metrics

    check_metrics(wanted)
    if not catalog.store.is_local:
        raise BadInput("--engine computes over a store that all tasks see at the same path: give --store, not --lake")
    if not os.access(catalog.kept, os.W_OK):
        raise StoreError(
            f"--engine keeps what it computes in {catalog.kept}, which cannot be written: ask without --engine, or as "
            "a user who may write there"
        )
    with status_line() as report, opened_engine(name, report) as engine, catalog.suspended_layers():
        unit_metrics(catalog, None, wanted, ClusterComputation(engine, counting(report, "computing", name)))


@contextmanager
def opened_tracing(engine: str | None, report: Callable[[str], None]) -> "Iterator[ClusterTracing | None]":
    """What reads and traces units by an engine, as long as that is open; None without one."""
    if engine is None:
        yield None
        return
    with opened_engine(engine, report) as opened:
        from analytics.cluster.diagnosis_tasks import ClusterTracing

        yield ClusterTracing(opened, counting(report, "reading", engine), counting(report, "tracing", engine))


def counting(report: Callable[[str], None], what: str, name: str) -> "Done":
    """Report how many of how many units are done."""
    return lambda done, total: report(f"{what}: {done:,} of {counted(total, 'unit')} on {name}")
