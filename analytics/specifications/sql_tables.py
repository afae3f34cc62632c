"""Tables behind the verdicts in SQL: limits, their parameters, unit factors, and names of metrics."""

import json
from collections.abc import Sequence
from contextlib import suppress

import msgspec
import pyarrow as pa

from analytics.metric_registry.registry import metrics
from storage.specifications.chain import Chain, read_chain
from storage.specifications.specification import Parameter, Product, SpecificationLimit, format_parameter
from storage.specifications.validity import NEVER, Edition, editions_of
from storage.sql.catalog import Catalog
from stream.errors import UnknownUnit
from stream.quantities import result_factor

_LIMITS = pa.schema(
    [
        ("limit_id", pa.int64()),
        ("specification", pa.string()),
        ("revision", pa.string()),
        ("from_ns", pa.int64()),
        ("until_ns", pa.int64()),
        ("known_from_ns", pa.int64()),
        ("known_until_ns", pa.int64()),
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
_PRODUCTS = pa.schema(
    [
        ("product", pa.string()),
        ("specification", pa.string()),
        ("from_ns", pa.int64()),
        ("known_from_ns", pa.int64()),
        ("known_until_ns", pa.int64()),
        ("scale_factor_unit", pa.string()),
        *((name, pa.float64()) for name in Product.__struct_fields__ if name != "scale_factor_unit"),
    ]
)
_HISTORY = pa.schema(
    [
        ("t_ns", pa.int64()),
        ("action", pa.string()),
        ("specification", pa.string()),
        ("revision", pa.string()),
        ("entered_by", pa.string()),
        ("reason", pa.string()),
        ("rejudges", pa.bool_()),
        ("content", pa.string()),
        ("sha256", pa.string()),
        ("previous", pa.string()),
    ]
)
_PROBLEMS = pa.schema([("problem", pa.string())])
_FACTORS = pa.schema([("source", pa.string()), ("target", pa.string()), ("factor", pa.float64())])
_NAMES = ("metric", "en", "zh", "unit_of_measure", "better", "standard", "clause", "parameters", "needs", "equation")


def put_specifications(catalog: Catalog) -> None:
    """Put the tables of the store's specifications: limits and products with the times in which they hold.

    ``limit_editions``, ``product_editions``, ``specification_limits``, ``specification_parameters``,
    ``specification_history`` and ``specification_problems``. A broken chain of documents gives no limits.
    """
    chain = read_chain(catalog.store, catalog)
    editions = editions_of(chain.links)
    limits: list[dict[str, object]] = []
    parameters: list[dict[str, object]] = []
    products: list[dict[str, object]] = []
    for each in editions:
        products += _product_rows(each)
        for limit in each.period.specification.limits if not chain.breaks else ():
            parameters += _parameter_rows(len(limits), limit)
            limits.append(_limit_row(len(limits), limit, each))
    catalog.put("limit_editions", pa.Table.from_pylist(limits, schema=_LIMITS))
    catalog.put("specification_limits", _limits_now(limits))
    catalog.put("specification_parameters", pa.Table.from_pylist(parameters, schema=_PARAMETERS))
    catalog.put("product_editions", pa.Table.from_pylist(products, schema=_PRODUCTS))
    catalog.put("specification_history", _history(chain))
    problems = [{"problem": f"the chain of specification documents is broken: {each.what}"} for each in chain.breaks]
    catalog.put("specification_problems", pa.Table.from_pylist(problems, schema=_PROBLEMS))


def put_names(catalog: Catalog) -> None:
    """Put the tables ``result_factors``, of the units of limits and values, and ``metric_names``."""
    catalog.put("result_factors", _factors(catalog))
    catalog.put("metric_names", _names())


def _limit_row(limit_id: int, limit: SpecificationLimit, edition: Edition) -> dict[str, object]:
    period = edition.period
    return {
        "limit_id": limit_id,
        "specification": period.specification.name,
        "revision": period.specification.revision,
        "from_ns": period.from_ns,
        "until_ns": period.until_ns,
        "known_from_ns": edition.known_from_ns,
        "known_until_ns": edition.known_until_ns,
        "valid": period.text,
        "revisions": edition.revisions,
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


def _limits_now(rows: Sequence[dict[str, object]]) -> pa.Table:
    """The limits known now."""
    now = pa.Table.from_pylist([row for row in rows if row["known_until_ns"] == NEVER], schema=_LIMITS)
    return now.drop_columns(["known_from_ns", "known_until_ns"])


def _product_rows(edition: Edition) -> list[dict[str, object]]:
    return [
        {
            "product": name,
            "specification": edition.period.specification.name,
            "from_ns": edition.period.from_ns,
            "known_from_ns": edition.known_from_ns,
            "known_until_ns": edition.known_until_ns,
            **msgspec.structs.asdict(numbers),
        }
        for name, numbers in edition.period.specification.products.items()
    ]


def _history(chain: Chain) -> pa.Table:
    rows = [
        {
            "t_ns": link.document.t_ns,
            "action": link.document.action.value,
            "specification": link.document.name,
            "revision": link.document.revision,
            "entered_by": link.document.by,
            "reason": link.document.reason,
            "rejudges": link.document.rejudges,
            "content": link.document.content,
            "sha256": link.hash,
            "previous": link.document.previous,
        }
        for link in chain.links
    ]
    return pa.Table.from_pylist(rows, schema=_HISTORY)


def _parameter_rows(limit_id: int, limit: SpecificationLimit) -> list[dict[str, object]]:
    return [
        {"limit_id": limit_id, "metric": limit.metric, "path": f"$.{json.dumps(name)}", "key": _key(value)}
        for name, value in limit.parameters.items()
    ]


def _key(value: Parameter) -> str:
    """Key by which parameters are compared: numbers to nine digits, everything else as its text."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"number {value:.9g}"
    return f"text {format_parameter(value)}"


def _factors(catalog: Catalog) -> pa.Table:
    """Factors from the units that values are in to those that limits are in; none where they do not fit."""
    pairs = catalog.rows(
        "select distinct m.unit_of_measure as source, l.unit_of_measure as target from unit_metrics m "
        "join internal.limit_editions l using (metric) where m.unit_of_measure is not null order by all"
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
        "parameters": [", ".join(each.parameters) for each in headers],
    }
    columns |= {name: [str(getattr(each, name)) for each in headers] for name in _NAMES if name not in columns}
    return pa.table({name: pa.array(columns[name], pa.string()) for name in _NAMES})
