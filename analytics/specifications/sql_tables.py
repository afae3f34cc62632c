"""Tables behind the verdicts in SQL: limits, their parameters, unit factors, and names of metrics."""

import json
from contextlib import suppress

import msgspec
import pyarrow as pa

from analytics.metric_registry.magnitudes import as_judged
from analytics.metric_registry.registry import metrics
from storage.specifications.chain import Chain, read_chain
from storage.specifications.specification import Parameter, Product, SpecificationLimit, format_parameter
from storage.specifications.validity import NEVER, Edition, editions_of
from storage.sql.catalog import Catalog
from stream.errors import UnknownUnit
from stream.quantities import result_factor

_TEXT, _WHOLE, _REAL = pa.string(), pa.int64(), pa.float64()
_LIMITS = pa.schema({
    "limit_id": _WHOLE, "specification": _TEXT, "revision": _TEXT, "from_ns": _WHOLE, "until_ns": _WHOLE,
    "known_from_ns": _WHOLE, "known_until_ns": _WHOLE, "valid": _TEXT, "revisions": _WHOLE, "metric": _TEXT,
    "subject": _TEXT, "parameters": _TEXT, "parameter_count": _WHOLE, "product": _TEXT, "signal": _TEXT,
    "standard": _TEXT, "lower": _REAL, "upper": _REAL, "unit_of_measure": _TEXT, "decision_rule": _TEXT,
    "guard_factor": _REAL, "largest_U": _REAL, "record_s": _REAL,
})  # fmt: skip
_PARAMETERS = pa.schema({"limit_id": _WHOLE, "metric": _TEXT, "path": _TEXT, "key": _TEXT})
_PRODUCTS = pa.schema({
    "product": _TEXT, "specification": _TEXT, "from_ns": _WHOLE, "known_from_ns": _WHOLE, "known_until_ns": _WHOLE,
    "scale_factor_unit": _TEXT,
} | dict.fromkeys((name for name in Product.__struct_fields__ if name != "scale_factor_unit"), _REAL))  # fmt: skip
_HISTORY = pa.schema({
    "t_ns": _WHOLE, "action": _TEXT, "specification": _TEXT, "revision": _TEXT, "entered_by": _TEXT, "reason": _TEXT,
    "rejudges": pa.bool_(), "known_ns": _WHOLE, "content": _TEXT, "sha256": _TEXT, "previous": _TEXT,
})  # fmt: skip
SPECIFICATION_TABLES = (
    "limit_editions", "specification_parameters", "product_editions", "specification_history", "specification_problems",
    "specification_limits",
)  # fmt: skip
_NAMES = ("metric", "en", "zh", "unit_of_measure", "better", "standard", "clause", "parameters", "needs", "equation")


def put_specifications(catalog: Catalog) -> None:
    """Put the tables of the store's specifications: limits and products with the times in which they hold.

    They are those of `SPECIFICATION_TABLES`. A broken chain of documents gives no limits.
    """
    chain = read_chain(catalog.store, catalog)
    editions = editions_of(chain.links)
    limits: list[dict[str, object]] = []
    parameters: list[dict[str, object]] = []
    products: list[dict[str, object]] = []
    for each in editions:
        products += _product_rows(each)
        for limit in each.period.specification.limits if not chain.breaks else ():
            for name, value in limit.parameters.items():
                of = {"limit_id": len(limits), "metric": limit.metric}
                parameters.append(of | {"path": f"$.{json.dumps(name)}", "key": parameter_key(value)})
            limits.append(_limit_row(len(limits), limit, each))
    problems = [{"problem": f"the chain of specification documents is broken: {each.what}"} for each in chain.breaks]
    now = [row for row in limits if row["known_until_ns"] == NEVER]
    for name, rows, schema in (
        ("limit_editions", limits, _LIMITS),
        ("specification_parameters", parameters, _PARAMETERS),
        ("product_editions", products, _PRODUCTS),
        ("specification_history", _history(chain), _HISTORY),
        ("specification_problems", problems, pa.schema({"problem": _TEXT})),
    ):
        catalog.put(name, pa.Table.from_pylist(rows, schema=schema))
    limits_now = pa.Table.from_pylist(now, schema=_LIMITS)
    catalog.put("specification_limits", limits_now.drop_columns(["known_from_ns", "known_until_ns"]))


def put_names(catalog: Catalog) -> None:
    """Put the tables ``result_factors``, of the units of limits and values, and ``metric_names``."""
    catalog.put("result_factors", _factors(catalog))
    catalog.put("metric_names", _names())


def _limit_row(limit_id: int, limit: SpecificationLimit, edition: Edition) -> dict[str, object]:
    period, specification = edition.period, edition.period.specification
    return msgspec.structs.asdict(as_judged(limit)) | {
        "limit_id": limit_id, "subject": limit.subject, "specification": specification.name,
        "revision": specification.revision, "from_ns": period.from_ns, "until_ns": period.until_ns,
        "known_from_ns": edition.known_from_ns, "known_until_ns": edition.known_until_ns, "valid": period.text,
        "revisions": edition.revisions,
        "parameters": json.dumps(limit.parameters, sort_keys=True, ensure_ascii=False),
        "parameter_count": len(limit.parameters), "decision_rule": limit.decision_rule.value,
        "guard_factor": 1.0 if limit.guard_factor is None else limit.guard_factor,
    }  # fmt: skip


def _product_rows(edition: Edition) -> list[dict[str, object]]:
    period = edition.period
    known = {"known_from_ns": edition.known_from_ns, "known_until_ns": edition.known_until_ns}
    shared = {"specification": period.specification.name, "from_ns": period.from_ns} | known
    products = period.specification.products.items()
    return [{"product": name, **shared, **msgspec.structs.asdict(numbers)} for name, numbers in products]


def _history(chain: Chain) -> list[dict[str, object]]:
    return [
        msgspec.structs.asdict(link.document)
        | {"action": link.document.action.value, "specification": link.document.name, "sha256": link.hash}
        | {"revision": link.document.revision, "entered_by": link.document.by, "known_ns": link.known_ns}
        for link in chain.links
    ]


def parameter_key(value: Parameter) -> str:
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
    return pa.Table.from_pylist(rows, schema=pa.schema({"source": _TEXT, "target": _TEXT, "factor": _REAL}))


def _names() -> pa.Table:
    headers = [metric.header for metric in metrics().values()]
    columns = {"metric": [each.id for each in headers], "unit_of_measure": [each.unit for each in headers]}
    columns |= {"parameters": [", ".join(each.parameters) for each in headers]}
    columns |= {name: [str(getattr(each, name)) for each in headers] for name in _NAMES if name not in columns}
    return pa.table({name: pa.array(columns[name], pa.string()) for name in _NAMES})
