"""What the JSON data source of Grafana asks (simpod-json-datasource): at this server's /api/grafana.

Signals come as three series, the least, greatest and mean value of each bucket, so that an outlier stays in the
picture at any width. Tables come by SQL.
"""

from typing import Any

import msgspec

from analytics.serve.api.encoding import Form
from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.query.signals import SignalAsked, signal
from analytics.serve.api.query.sql import SqlAsked, answered
from analytics.serve.api.rows import moment
from analytics.serve.doors.roles import Role
from storage.sql.reading import find_signal
from stream.decoding import decode_json
from stream.errors import BadInput

_SERIES = ("min", "max", "mean")
_NAMES = ("unit", "run", "signal")
_MOST_TARGETS = 50
_MOST_POINTS = 10_000
_MS = 10**6
_GRAFANA_TYPES = {"int": "number", "uin": "number", "dou": "number", "flo": "number", "dec": "number", "boo": "boolean"}


class MetricsAsked(msgspec.Struct, frozen=True):
    """The query as it is so far."""

    metric: str = ""
    payload: Any = None


class OptionsAsked(msgspec.Struct, frozen=True):
    """The query as it is so far, and the part of it whose options are asked."""

    name: str
    metric: str = ""
    payload: Any = None


class Range(msgspec.Struct, frozen=True, rename={"from_": "from"}):
    """A stretch of time."""

    from_: str
    to: str


class Target(msgspec.Struct, frozen=True, rename={"ref_id": "refId"}):
    """One query of a panel."""

    target: str = ""
    ref_id: str = ""
    payload: Any = None
    hide: bool = False


class QueryAsked(msgspec.Struct, frozen=True, rename={"points": "maxDataPoints"}):
    """Queries of a panel, their stretch of time, and how many points it can show."""

    targets: list[Target]
    range: Range | None = None
    points: int = 1000


class VariableAsked(msgspec.Struct, frozen=True):
    """The text of a variable: units, runs, signals."""

    payload: Any = None


@get("/api/grafana", is_kept=False)
def grafana(call: Call, asked: Nothing) -> dict[str, str]:
    """The test of the connection."""
    del call, asked
    return {"status": "ok"}


@post("/api/grafana/metrics", role=Role.VIEWER)
def grafana_metrics(call: Call, asked: MetricsAsked) -> list[dict[str, Any]]:
    """What can be queried, and with which parts."""
    del call, asked
    parts = [{"name": name, "label": name, "type": "select", "reloadMetric": True} for name in _NAMES]
    return [
        {"value": "signal", "label": "signal (min, max, mean)", "payloads": parts},
        {"value": "sql", "label": "SQL table", "payloads": [{"name": "sql", "label": "statement", "type": "textarea"}]},
    ]


@post("/api/grafana/metric-payload-options", role=Role.VIEWER)
def grafana_options(call: Call, asked: OptionsAsked) -> list[dict[str, str]]:
    """Units, runs or signals that fit what is chosen so far."""
    if asked.name not in _NAMES:
        return []
    return [{"label": name, "value": name} for name in _names(call, asked.name, _fields(asked.payload))]


@post("/api/grafana/variable", role=Role.VIEWER)
def grafana_variable(call: Call, asked: VariableAsked) -> list[dict[str, str]]:
    """Values of a variable whose query is units, runs or signals."""
    fields = _fields(asked.payload)
    wanted = str(fields.get("target", "")).strip().removesuffix("s")
    if wanted not in _NAMES:
        raise BadInput(f"the query of the variable is {fields.get('target')!r}; write units, runs or signals")
    return [{"__text": name, "__value": name} for name in _names(call, wanted, fields)]


@post("/api/grafana/query", role=Role.VIEWER)
def grafana_query(call: Call, asked: QueryAsked) -> list[dict[str, Any]]:
    """Series and tables of a panel."""
    if len(asked.targets) > _MOST_TARGETS:
        raise BadInput(f"{len(asked.targets)} queries at once; {_MOST_TARGETS} may be")
    found: list[dict[str, Any]] = []
    for target in asked.targets:
        fields = _fields(target.payload)
        if target.hide or not target.target:
            continue
        found += _table(call, fields) if target.target == "sql" else _series(call, asked, target, fields)
    return found


@post("/api/grafana/tag-keys", role=Role.VIEWER)
def grafana_tag_keys(call: Call, asked: VariableAsked) -> list[dict[str, str]]:
    """None: filters are parts of the queries."""
    del call, asked
    return []


def _series(call: Call, asked: QueryAsked, target: Target, fields: dict[str, Any]) -> list[dict[str, Any]]:
    """Three series of a signal, named in the payload or as ``UNIT/RUN/SIGNAL``."""
    if target.target != "signal":
        parts = target.target.split("/")
        fields = fields | dict(zip(_NAMES, parts, strict=False))
    of = {name: str(fields.get(name) or "") for name in _NAMES}
    if not of["unit"] or not of["signal"]:
        raise BadInput(f"query {target.ref_id or target.target}: choose a unit and a signal, or write UNIT/RUN/SIGNAL")
    record = find_signal(call.views, of["unit"], of["signal"], of["run"] or None)
    stretch = SignalAsked(
        from_=None if asked.range is None else str(moment(asked.range.from_, "from")),
        to=None if asked.range is None else str(moment(asked.range.to, "to")),
        points=min(max(asked.points, 2), _MOST_POINTS),
    )
    inner = Call(call.service, call.person, call.state, of | {"run": record.run})
    with inner:
        buckets = signal(inner, stretch)
    name = f"{record.unit} {record.signal}"
    return [
        {
            "target": f"{name} {series}",
            "refId": target.ref_id,
            "unit": buckets.unit_of_measure,
            "datapoints": [
                [value, t_ns // _MS] for value, t_ns in zip(getattr(buckets, series), buckets.t_ns, strict=True)
            ],
        }
        for series in _SERIES
    ]


def _table(call: Call, fields: dict[str, Any]) -> list[dict[str, Any]]:
    asked = SqlAsked(sql=str(fields.get("sql") or ""), shape="arrays")
    rows = decode_json(answered(call, asked).encoded(Form.JSON).body)
    columns = [
        {"text": each["name"], "type": _GRAFANA_TYPES.get(each["type"][:3], "string")} for each in rows["columns"]
    ]
    return [{"type": "table", "columns": columns, "rows": rows["rows"]}]


def _fields(payload: Any) -> dict[str, Any]:
    """Parts of a query: an object, or one as text."""
    if isinstance(payload, str) and payload.strip():
        try:
            payload = decode_json(payload)
        except msgspec.DecodeError:
            return {"target": payload}
    return payload if isinstance(payload, dict) else {}


def _names(call: Call, wanted: str, chosen: dict[str, Any]) -> list[str]:
    given = {name: str(chosen.get(name) or "") for name in _NAMES if name != wanted}
    where = " and ".join(f"(${name} = '' or {name} = ${name})" for name in given)
    sql_text = f"select distinct {wanted} from signals where {where} order by 1 limit 5000"  # noqa: S608  our own names
    return [str(name) for (name,) in call.views.rows(sql_text, given)]
