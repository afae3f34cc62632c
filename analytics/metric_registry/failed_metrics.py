"""Metrics of the site's own that fail: they are reported by their file, and all others have their values."""

import importlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from analytics.metric_registry.registry import Metric, metrics, unreadable_metrics
from storage.sql.catalog import Catalog
from stream.errors import QueryError

OF_THE_COMPUTER = (duckdb.IOException, duckdb.OutOfMemoryException, duckdb.InterruptException, duckdb.FatalException)
_RUNS = "select distinct unit, run from step_means order by all"
_FAILED = "cannot be computed: "
_MOST_LETTERS = 300
_REASONS = """
select distinct metric, reason from unit_metrics where reason is not null and list_contains($metrics, metric)
order by all
"""


def failure(metric: Metric, what: str) -> QueryError:
    """The error that a metric cannot be computed, with the file of its definition."""
    text = what if len(what) <= _MOST_LETTERS else f"{what[:_MOST_LETTERS]} ..."
    return QueryError(f"metric {metric.header.id} {_FAILED}{text}; its definition is {metric.place}{_function(metric)}")


def _function(metric: Metric) -> str:
    """The function that a metric's header names, with its file where that is the site's own."""
    module, _, function = metric.header.python.partition(":")
    file = Path(metric.own_file).parent / f"{module.rpartition('.')[2]}.py"
    if metric.own_file and function and file.is_file():
        return f" ({function} in {file})"
    return f" ({metric.header.python})" if function else ""


def _is_of_the_computer(error: BaseException | None) -> bool:
    """Whether an error, or what it comes from, is no mistake of a statement, as where memory lacks."""
    while error is not None:
        if isinstance(error, (*OF_THE_COMPUTER, MemoryError, OSError)):
            return True
        error = error.__cause__
    return False


def failed_rows(catalog: Catalog, metric: Metric, error: QueryError, schema: pa.Schema) -> pa.Table:
    """A row for each unit and run without a value, whose reason is the error of a metric of the site's own.

    Raises the error of another metric, and one that is no mistake of the metric.
    """
    if not metric.own_file or _is_of_the_computer(error):
        raise error
    reason = " ".join(str(error).split())
    header = metric.header
    usual = {
        "metric": header.id, "unit_of_measure": header.unit, "parameters": "{}", "standard": header.standard,
        "clause": header.clause, "reason": reason, "steps": [],
    }  # fmt: skip
    rows = [{"unit": unit, "run": run, "runs": [run]} | usual for unit, run in catalog.rows(_RUNS)]
    return pa.Table.from_pylist(rows, schema=schema)


def lacking_modules() -> Mapping[str, str]:
    """Errors of the functions of the site's own metrics that cannot be imported, by metric."""
    found = {}
    for name, metric in metrics().items():
        module = metric.header.python.partition(":")[0]
        if metric.own_file and module:
            try:
                importlib.import_module(module)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a module of the site's own raises any
                found[name] = f"{type(error).__name__}: {error}"
    return found


def remarks_on_failed(catalog: Catalog, rows: Iterable[Mapping[str, Any]] | None = None) -> Iterator[str]:
    """What is wrong with metrics of the site's own: files that cannot be read, metrics that cannot be computed.

    These are looked for among the `rows`; among all values of the catalogue where none are given.
    """
    yield from unreadable_metrics().values()
    own = [name for name, metric in metrics().items() if metric.own_file]
    if rows is not None:
        found = dict.fromkeys((row["metric"], row["reason"]) for row in rows if row["metric"] in own and row["reason"])
    else:
        found = dict.fromkeys(catalog.rows(_REASONS, {"metrics": own}) if own else [])
    yield from (reason for metric, reason in found if reason.startswith(f"metric {metric} {_FAILED}"))
