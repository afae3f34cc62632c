"""The metrics there are: each is one file in this package, found here by itself."""

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import pyarrow as pa

from analytics.metrics.header import MetricError, MetricHeader, parse_header
from storage.sql.catalog import Catalog

Compute = Callable[[Catalog], pa.Table | Iterable[Mapping[str, Any]]]


class Metric(NamedTuple):
    """A metric: an SQL statement over the step records, or a function where SQL cannot say it.

    Either gives rows with ``unit, signal, run, value, standard_uncertainty, freedom, n, parameters, runs, steps,
    reason``; where limits are given also ``lo, hi``; where a file serves two standards differently also ``standard,
    clause``. `value` is null just where `reason` says why.
    """

    header: MetricHeader
    sql: str | None = None
    compute: Compute | None = None


@cache
def metrics() -> Mapping[str, Metric]:
    """All metrics by id, in alphabetical order.

    An SQL file is a metric by its header; a module is one that has ``HEADER`` (the same lines as text) and ``compute``.

    Raises
    ------
    MetricError: If a file is not written as it must be, or two have one id.

    Examples
    --------
    >>> metrics()["bias"].header.unit
    'deg/h'
    """
    found: dict[str, Metric] = {}
    for metric in [*_written(), *_programmed()]:
        if metric.header.id in found:
            raise MetricError(f"two metrics are called {metric.header.id}")
        found[metric.header.id] = metric
    return dict(sorted(found.items()))


def _written() -> Iterable[Metric]:
    for file in files("analytics.metrics").iterdir():
        if file.name.endswith(".sql"):
            text = file.read_text(encoding="utf-8")
            header = parse_header(text, file.name)
            if file.name != f"{header.id}.sql":
                raise MetricError(f"metric {file.name}: its header calls it {header.id}")
            yield Metric(header, sql=text)


def _programmed() -> Iterable[Metric]:
    package = importlib.import_module("analytics.metrics")
    for module_info in pkgutil.iter_modules(package.__path__):
        module = importlib.import_module(f"analytics.metrics.{module_info.name}")
        if hasattr(module, "HEADER"):
            yield Metric(parse_header(module.HEADER, module_info.name), compute=module.compute)
