"""Moments with an offset in users' statements and parameters mean the instant that they name.

Times of the store are UTC without a zone, and DuckDB drops the offset of a text that it casts to such a time. Here a
text in such a place is replaced by its moment in UTC. Texts that are used as texts stay as they are.
"""

import json
import re
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from itertools import compress
from typing import Any, NamedTuple

import duckdb

from stream.errors import QueryError

_MOMENT = re.compile(
    r"\s*(?P<whole>\d{1,6}[-/\\ ]\d{1,2}[-/\\ ]\d{1,2}[T ]\s*\d{1,2}:\d{1,2}(?::\d{1,2})?)(?P<fraction>\.\d*)?"
    r"\s*(?P<zone>[+-]\d{2}[\d:]*|[A-Za-z][\w/+-]*)\s*",
    re.IGNORECASE,
)
_LIKE_ONE = re.compile(r":\d{1,2}(?:\.\d*)?\s*(?:[+-]\d|[A-Za-z])")  # in a statement
_UTC = {"z", "utc"}
_TIMES = re.compile(r"(timestamp|datetime|date)(_\w+)?( without time zone)?", re.IGNORECASE)
_ZONED = re.compile(r"timestamptz|timestamp with time zone", re.IGNORECASE)
_EQUALITIES = {"COMPARE_EQUAL", "COMPARE_NOTEQUAL", "COMPARE_DISTINCT_FROM", "COMPARE_NOT_DISTINCT_FROM"}
_BEFORE_DEFAULT = 2  # arguments of LAG


class _Site(NamedTuple):
    """Where a statement has a moment with an offset: as a literal, or the name of its parameter."""

    node: dict[str, Any]
    text: str
    name: str | None
    begin: int  # in the bytes of the statement
    length: int
    is_cast: bool  # to a time, by the statement itself
    is_within: bool  # what is cast to times in another way: of a record, or of an expression
    group: int  # the same for members of a list, which have one type


def in_utc(connection: duckdb.DuckDBPyConnection, sql: str, parameters: object) -> tuple[str, object]:
    """The statement and its parameters with moments in UTC wherever DuckDB would take their texts for times.

    >>> connection = duckdb.connect()
    >>> in_utc(connection, "select timestamp '2026-11-20T08:00:10+08:00' > $a", {"a": "2026-11-20T07:00+08"})
    ("select timestamp '2026-11-20 00:00:10+00' > $a", {'a': '2026-11-19 23:00:00+00'})
    >>> in_utc(connection, "select '2026-11-20T08:00:10+08:00' = 'a'", None)
    ("select '2026-11-20T08:00:10+08:00' = 'a'", None)
    """
    values = _without_zones(parameters)
    named = _by_name(values)
    if not _LIKE_ONE.search(sql) and next(_offsets_in(named), None) is None:
        return sql, values
    ((tree,),) = connection.execute("select json_serialize_sql(?::varchar)", [sql]).fetchall()
    if json.loads(tree)["error"]:  # no SELECT: it only explains
        return sql, values
    sites = list(_sites(json.loads(tree), named))
    of_times = _taken_for_times(connection, tree, named, values)
    as_texts = {each.name for each, is_time in zip(sites, of_times, strict=True) if not is_time}
    edits = {}
    for each in compress(sites, of_times):
        text = _utc(connection, each.text)
        if each.name is None or each.name in as_texts:  # such a parameter keeps its text elsewhere
            edits[_place(sql, each)] = f"'{text}'"
        else:
            named[each.name] = text
    filled = list(named.values()) if isinstance(values, list) else named or values
    return _edited(sql, edits), filled


def _has_offset(text: object) -> bool:
    found = _MOMENT.fullmatch(text) if isinstance(text, str) else None
    return found is not None and found["zone"].lower() not in _UTC


def _without_zones(value: object) -> Any:
    """The value, with datetimes that have a zone as UTC without one."""
    if isinstance(value, datetime):
        try:
            return value if value.tzinfo is None else value.astimezone(UTC).replace(tzinfo=None)
        except OverflowError:  # before the year 1 or after 9999 in UTC
            raise QueryError(f"the moment {value} has no date in UTC: give one between the years 1 and 9999") from None
    if isinstance(value, Mapping):
        return {name: _without_zones(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_zones(each) for each in value]
    return value


def _by_name(parameters: object) -> dict[str, Any]:
    if isinstance(parameters, Mapping):
        return dict(parameters)
    if isinstance(parameters, list):
        return {str(number): each for number, each in enumerate(parameters, 1)}
    return {}


def _sites(tree: Any, parameters: Mapping[str, Any]) -> Iterator[_Site]:
    waiting: list[tuple[Any, tuple[dict[str, Any], ...], bool, int]] = [(tree, (), False, 0)]
    while waiting:
        each, casts, is_within, group = waiting.pop()
        if isinstance(each, list):
            waiting.extend((inner, (), is_within, group or id(inner)) for inner in each)
        if not isinstance(each, dict):
            continue
        kind = each.get("class")
        literal = each.get("literal") if kind == "CONSTANT" else None
        name = str(each["identifier"]) if kind == "PARAMETER" else None
        text = parameters.get(name) if name is not None else literal and literal.get("text")
        to_times = is_within or any(_has_times(cast["type_expr"]) for cast in casts)
        if to_times and not isinstance(text, str) and (inner := next(_offsets_in(text), None)) is not None:
            raise QueryError(
                f"parameter {name} has {inner!r}, whose offset a cast drops: give datetimes, or texts in UTC"
            )
        has_zone = bool(casts) and _ZONED.fullmatch(casts[-1]["type_expr"]["type_name"]) is not None
        if isinstance(text, str) and _has_offset(text) and not has_zone:
            at = next((one for one in (each, *reversed(casts)) if one["query_location_length"]), each)
            is_cast = any(_is_time(cast["type_expr"]) for cast in casts)
            place = at["query_location"], at["query_location_length"]
            yield _Site(each, text, name, *place, is_cast, is_within and not is_cast, group or id(each))
        if kind == "CAST":
            waiting.append((each["child"], (*casts, each), is_within or _has_times(each["type_expr"]), group))
        elif each.get("function_name") == "list_value":
            one = group or id(each)
            waiting.extend((argument["expression"], casts, is_within, one) for argument in each["arguments"])
        elif each.get("type") == "COMPARE_IN":
            waiting.extend((inner, (), is_within, id(each)) for inner in each["children"])
        else:
            waiting.extend((inner, (), is_within, 0) for inner in each.values())


def _offsets_in(value: Any) -> Iterator[str]:
    """Texts with an offset in a list or record."""
    if isinstance(value, Mapping | list | tuple):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from _offsets_in(each)
    elif _has_offset(value):
        yield value


def _has_times(kind: dict[str, Any]) -> bool:
    """Whether a type is that of times or has such members."""
    return (
        re.search(r'"(timestamp|datetime|date)(_\w+)?( without time zone)?"', json.dumps(kind), re.IGNORECASE)
        is not None
    )


def _is_time(kind: dict[str, Any]) -> bool:
    """Whether a type is that of times without a zone, or a list of them."""
    while kind["type_name"].lower() == "list" and kind["children"]:
        kind = kind["children"][0]
    return _TIMES.fullmatch(kind["type_name"]) is not None


def _taken_for_times(
    connection: duckdb.DuckDBPyConnection, tree: str, named: Mapping[str, Any], values: object
) -> list[bool]:
    """Of each site, whether DuckDB casts the text to a time.

    Where it does so by itself, it does not accept an expression that is a text.
    """
    probe = _Probe(connection, tree, named, values)
    if not probe.asked:
        return [each.is_cast for each in probe.sites]
    _forbid_casts(probe.tree)
    is_forbidden = probe.is_valid([])
    if not is_forbidden:
        probe = _Probe(connection, tree, named, values)
        if not probe.is_valid([]):  # its error comes when it runs
            return [each.is_cast for each in probe.sites]
    groups: dict[int, list[_Site]] = {}
    for each in probe.asked:
        groups.setdefault(each.group, []).append(each)
    is_text = probe.is_valid(probe.asked)
    texts = {group for group, sites in groups.items() if is_text or probe.is_valid(sites)}
    for each in probe.asked:
        if each.group in texts and (each.is_within or not is_forbidden):  # a comparison may cast it all the same
            raise QueryError(
                f"this statement may take {each.text!r} for a time, and would drop its offset: write the moment in UTC "
                "without one"
            )
    return [each.is_cast or each.group not in texts for each in probe.sites]


class _Probe:
    """Asks DuckDB whether a statement is valid with some of its texts cast to text."""

    def __init__(
        self, connection: duckdb.DuckDBPyConnection, tree: str, named: Mapping[str, Any], values: object
    ) -> None:
        self.tree: dict[str, Any] = json.loads(tree)
        self.sites = list(_sites(self.tree, named))
        self.asked = [each for each in self.sites if not each.is_cast]
        self._connection, self._values = connection, values
        ((cast,),) = connection.execute("select json_serialize_sql('select null::varchar')").fetchall()
        self._cast: dict[str, Any] = json.loads(cast)["statements"][0]["node"]["select_list"][0]

    def is_valid(self, as_texts: list[_Site]) -> bool:
        """Whether the statement is valid with these cast to text."""
        for site in as_texts:
            own = dict(site.node)
            site.node.clear()
            site.node.update(self._cast | {"child": own})
        tree = json.dumps(self.tree)
        for site in as_texts:
            own = site.node["child"]
            site.node.clear()
            site.node.update(own)
        try:
            ((sql,),) = self._connection.execute("select json_deserialize_sql(?::json)", [tree]).fetchall()
            self._connection.execute(f"describe {sql}", self._values).fetchall()
        except duckdb.Error:
            return False
        return True


def _forbid_casts(tree: Any) -> None:
    """Replace what casts even an expression that is a text (=, IN, NULLIF, the default of LAG) by what does not."""
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        if isinstance(each, list):
            waiting.extend(each)
        if not isinstance(each, dict):
            continue
        kind = each.get("type")
        if kind in _EQUALITIES:
            each["type"] = "COMPARE_GREATERTHAN"
        elif kind == "FUNCTION" and str(each.get("function_name")).lower() == "nullif":
            each.update(function_name="ifnull", qualified_name={"path": ["ifnull"]})
        elif kind == "COMPARE_IN":
            each.update(type="OPERATOR_IS_NOT_NULL", children=[_coalesced(each["children"])])
        elif kind in {"WINDOW_LAG", "WINDOW_LEAD"} and len(each["arguments"]) > _BEFORE_DEFAULT:
            first, _, default = (argument["expression"] for argument in each["arguments"])
            each["arguments"] = [{"name": "", "expression": _coalesced([first, default])}]
        waiting.extend(each.values())


def _coalesced(children: list[Any]) -> dict[str, Any]:
    return {"class": "OPERATOR", "type": "OPERATOR_COALESCE", "alias": "", "children": children}


def _utc(connection: duckdb.DuckDBPyConnection, text: str) -> str:
    found = _MOMENT.fullmatch(text)
    assert found is not None
    zone = found["zone"] if found["zone"][0] in "+-" else f" {found['zone']}"
    try:
        ((moment,),) = connection.execute(
            "select timezone('UTC', ?::varchar::timestamptz)::varchar", [found["whole"] + zone]
        ).fetchall()
    except duckdb.Error:
        raise QueryError(
            f"the moment {text!r} has no time zone that is known: write its offset, as 2026-11-21T18:00:00+08:00, or "
            "the moment in UTC without one"
        ) from None
    return f"{moment}{found['fraction'] or ''}+00"


def _place(sql: str, site: _Site) -> tuple[int, int]:
    """Where the literal or the parameter begins and ends in the bytes of the statement."""
    stop = site.begin + site.length
    tokens = [(begin, kind) for begin, kind in duckdb.tokenize(sql) if site.begin <= begin < stop]
    begins = [begin for begin, kind in tokens if site.name is not None or kind == duckdb.token_type.string_const]
    if not begins or (site.name is None and len(begins) > 1):
        raise QueryError(f"the moment {site.text!r} has an offset: write it in UTC, without one")
    return begins[0], stop


def _edited(sql: str, edits: Mapping[tuple[int, int], str]) -> str:
    content = sql.encode()
    for (begin, stop), text in sorted(edits.items(), reverse=True):
        content = content[:begin] + text.encode() + content[stop:]
    return content.decode()
