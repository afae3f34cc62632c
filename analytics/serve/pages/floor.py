"""The floor: stations with their runs, and the units by how much they need somebody."""

from collections import Counter
from typing import Any, Literal

import msgspec

from analytics.alerts.rules import ALARM, WARNING
from analytics.serve.api import live as api
from analytics.serve.api.alerts import AlertsAsked, list_alerts
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.api.rows import Name
from analytics.serve.live.floor_rows import STATE_COLUMNS, UNIT_COLUMNS
from analytics.serve.pages.frame.page import shown

_ROWS = 200
# what needs somebody first: failed, aborted, at the limit, without data, silent; then the undecided
_ORDER = {"FAIL": 0, "ABORTED": 1, "MARGINAL": 2, "NO_DATA": 3, "": 5, "PASS": 6}
_SILENT = 4


class FloorAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which units: those of a run, of a verdict so far, silent ones, or released ones."""

    run: Name = ""
    station: Name = ""
    verdict: Name = ""
    silent: Literal["", "1"] = ""
    released: Literal["", "1"] = ""
    page: int = 1


@shown("/", "floor.html.jinja", shared_s=0.5)
def floor(call: Call, asked: FloorAsked) -> dict[str, Any]:
    """The floor."""
    found = api.floor(call, Nothing())
    stations = {run["run"]: run["station"] for run in found.runs}
    rows = [_row(found, unit, state) for unit, state in zip(found.units, found.states, strict=True)]
    chosen = [row for row in rows if _is_chosen(row, stations, asked)]
    chosen.sort(key=lambda row: (min(_ORDER.get(row["so_far"], 5), _SILENT if row["silent"] else 9), row["unit"]))
    first = (max(asked.page, 1) - 1) * _ROWS
    asked_for = msgspec.to_builtins(asked) | {"page": asked.page + 1}
    return {
        "found": found,
        "rows": chosen[first : first + _ROWS],
        "count": len(chosen),
        "stations": stations,
        "zones": {run["run"]: run["time_zone"] for run in found.runs},
        "alerts": _open_alerts(call),
        "next": link("", **asked_for) if len(chosen) > first + _ROWS else None,
        "data": "/api/floor",
        "has_table": False,
    }


def _open_alerts(call: Call) -> dict[str, int]:
    """How many alerts are open by severity, alarms first."""
    counts = Counter(each.severity for each in list_alerts(call, AlertsAsked()).alerts)
    return {severity: counts[severity] for severity in (ALARM, WARNING) if counts[severity]}


def _row(found: api.FloorDocument, unit: list[Any], state: list[Any]) -> dict[str, Any]:
    row = dict(zip(UNIT_COLUMNS, unit, strict=True)) | dict(zip(STATE_COLUMNS, state, strict=True))
    return row | {"so_far": found.verdicts[row["verdict"]], "step": found.steps[row["step"]]}


def _is_chosen(row: dict[str, Any], stations: dict[str, str], asked: FloorAsked) -> bool:
    verdict = row["so_far"] or "OPEN"
    return (
        asked.run in ("", row["run"])
        and asked.station in ("", stations.get(row["run"], ""))
        and asked.verdict in ("", verdict)
        and (not asked.silent or bool(row["silent"]))
        and (not asked.released or bool(row["released"]))
    )
