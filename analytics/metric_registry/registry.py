"""The registry of metrics: each file in `analytics/metrics` is one, found automatically."""

import difflib
import importlib
import json
import pkgutil
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import pyarrow as pa

from analytics.metric_registry.header import MetricError, MetricHeader, parse_header
from storage.sql.catalog import Catalog
from stream.errors import BadInput

Compute = Callable[[Catalog], pa.Table | Iterable[Mapping[str, Any]]]
_PACKAGE = "analytics.metrics"


class Metric(NamedTuple):
    """A metric: an SQL statement over the step records, or a function where SQL cannot express it.

    Either gives rows with ``unit, signal, run, value, standard_uncertainty, freedom, n, parameters, runs, steps,
    reason``; with given bounds also ``lo, hi``; where two standards differ also ``standard, clause``. `value` is null
    exactly where `reason` says why. A function may omit `runs` (the run) and yields `parameters` as a mapping.
    """

    header: MetricHeader
    sql: str | None = None
    compute: Compute | None = None


@cache
def metrics() -> Mapping[str, Metric]:
    """All metrics by id, in alphabetical order.

    An SQL file is a metric by its header, a module by ``HEADER`` (the same lines as text) and ``compute``.

    Raises
    ------
    MetricError: If a file is malformed, or two have one id.

    Examples
    --------
    >>> metrics()["bias"].header.unit
    'deg/h'
    """
    found: dict[str, Metric] = {}
    for metric in [*_from_sql(), *_from_modules()]:
        if metric.header.id in found:
            raise MetricError(f"two metrics are called {metric.header.id}")
        found[metric.header.id] = metric
    return dict(sorted(found.items()))


def _from_sql() -> Iterable[Metric]:
    for file in files(_PACKAGE).iterdir():
        if file.name.endswith(".sql"):
            text = file.read_text(encoding="utf-8")
            header = parse_header(text, file.name)
            if file.name != f"{header.id}.sql":
                raise MetricError(f"metric {file.name}: its header calls it {header.id}")
            yield Metric(header, sql=text)


def _from_modules() -> Iterable[Metric]:
    for module_info in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__):
        module = importlib.import_module(f"{_PACKAGE}.{module_info.name}")
        yield Metric(parse_header(module.HEADER, module_info.name), compute=module.compute)


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """Parameters as the JSON text of their column.

    Examples
    --------
    >>> parameters_text({"kind": "all", "power_ons": 6})
    '{"kind":"all","power_ons":6}'
    """
    return json.dumps(parameters, ensure_ascii=False, separators=(",", ":"))


def check_metrics(names: Iterable[str], where: str = "") -> None:
    """Refuse names of unknown metrics.

    Raises
    ------
    BadInput: The message names similar metrics.

    Examples
    --------
    >>> check_metrics(["biass"], "spec.toml: $.limit[0]")
    Traceback (most recent call last):
    stream.errors.BadInput: spec.toml: $.limit[0]: there is no metric 'biass'; did you mean bias?
    """
    for name in names:
        if name not in metrics():
            place = f"{where}: " if where else ""
            raise BadInput(f"{place}there is no metric {name!r}; {alike(name, metrics(), 'metrics are')}")


def alike(name: str, known: Collection[str], else_: str) -> str:
    """Suggest a similar name; where there is none, list some known ones after the words `else_`.

    Examples
    --------
    >>> alike("FOG-O231", ["FOG-0230", "FOG-0231"], "there are")
    'did you mean FOG-0231?'
    """
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    folded = [each for each in known if each.casefold() == name.casefold()]
    if folded or near:
        return f"did you mean {(folded or near)[0]}?"
    names = sorted(known)
    return f"{else_} {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}" if names else "there is none"
