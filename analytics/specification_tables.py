"""What the verdicts in SQL stand on: the limits, their parameters, factors between units, and the metrics' names."""

import json
from contextlib import suppress

import pyarrow as pa

from analytics.metrics.registry import metrics
from analytics.specification import Parameter, SpecificationLimit, told_parameter
from analytics.specification_store import Period, periods_of, stored_specifications
from storage.catalog import Catalog
from stream.errors import UnknownUnit
from stream.quantities import result_factor

_LIMITS = pa.schema(
    [
        ("limit_id", pa.int64()),
        ("specification", pa.string()),
        ("revision", pa.string()),
        ("from_ns", pa.int64()),
        ("until_ns", pa.int64()),
        ("valid", pa.string()),
        ("revisions", pa.int64()),
        ("metric", pa.string()),
        ("subject", pa.string()),
        ("parameters", pa.string()),
        ("parameter_count", pa.int64()),
        ("product", pa.string()),
        ("signal", pa.string()),
        ("standard", pa.string()),
        ("lower", pa.float64()),
        ("upper", pa.float64()),
        ("unit_of_measure", pa.string()),
    ]
)
_PARAMETERS = pa.schema(
    [("limit_id", pa.int64()), ("metric", pa.string()), ("path", pa.string()), ("key", pa.string())]
)
_FACTORS = pa.schema([("source", pa.string()), ("target", pa.string()), ("factor", pa.float64())])
_NAMES = ("metric", "en", "zh", "unit_of_measure", "better", "standard", "clause", "needs", "equation")


def put_specifications(catalog: Catalog) -> None:
    """Put the tables ``specification_limits``, ``specification_parameters``, ``result_factors`` and ``metric_names``.

    Raises
    ------
    BadInput
        If a specification in the store is not right.
    """
    periods = periods_of(stored_specifications(catalog.store))
    rows: list[dict[str, object]] = []
    parameters: list[dict[str, object]] = []
    for period in periods:
        revisions = sum(each.specification.name == period.specification.name for each in periods)
        for limit in period.specification.limits:
            rows.append(_limit_row(len(rows), limit, period, revisions))
            parameters += _parameter_rows(len(rows) - 1, limit)
    catalog.put("specification_limits", pa.Table.from_pylist(rows, schema=_LIMITS))
    catalog.put("specification_parameters", pa.Table.from_pylist(parameters, schema=_PARAMETERS))
    catalog.put("result_factors", _factors(catalog))
    catalog.put("metric_names", _names())


def _limit_row(limit_id: int, limit: SpecificationLimit, period: Period, revisions: int) -> dict[str, object]:
    return {
        "limit_id": limit_id,
        "specification": period.specification.name,
        "revision": period.specification.revision,
        "from_ns": period.from_ns,
        "until_ns": period.until_ns,
        "valid": period.told,
        "revisions": revisions,
        "metric": limit.metric,
        "subject": limit.subject,
        "parameters": json.dumps(limit.parameters, sort_keys=True, ensure_ascii=False),
        "parameter_count": len(limit.parameters),
        "product": limit.product,
        "signal": limit.signal,
        "standard": limit.standard,
        "lower": limit.lower,
        "upper": limit.upper,
        "unit_of_measure": limit.unit_of_measure,
    }


def _parameter_rows(limit_id: int, limit: SpecificationLimit) -> list[dict[str, object]]:
    return [
        {"limit_id": limit_id, "metric": limit.metric, "path": f"$.{json.dumps(name)}", "key": _key(value)}
        for name, value in limit.parameters.items()
    ]


def _key(value: Parameter) -> str:
    """What a value's parameter is compared with: numbers to nine digits, everything else as its text."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"number {value:.9g}"
    return f"text {told_parameter(value)}"


def _factors(catalog: Catalog) -> pa.Table:
    """Factors from the units that values are in to those that limits are in; none where they do not fit."""
    pairs = catalog.rows(
        "select distinct m.unit_of_measure as source, l.unit_of_measure as target from unit_metrics m "
        "join specification_limits l using (metric) where m.unit_of_measure is not null order by all"
    )
    rows = []
    for source, target in pairs:
        with suppress(UnknownUnit):
            rows.append({"source": source, "target": target, "factor": result_factor(source, target)})
    return pa.Table.from_pylist(rows, schema=_FACTORS)


def _names() -> pa.Table:
    headers = [metric.header for metric in metrics().values()]
    columns = {
        "metric": [each.id for each in headers],
        "unit_of_measure": [each.unit for each in headers],
    } | {
        name: [str(getattr(each, name)) for each in headers]
        for name in _NAMES
        if name not in {"metric", "unit_of_measure"}
    }
    return pa.table({name: pa.array(columns[name], pa.string()) for name in _NAMES})
