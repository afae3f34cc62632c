"""What the lake knows of signals: read at once where there are few, else of each that is asked for."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

from analytics.serve.api.operation import Call
from analytics.serve.api.rows import dictionaries

_MOST_PARTS = 50_000
_COUNT = "select count(*) from internal.served_parts"
# without a unit, of all
_ABOUT = """
select s.unit, s.signal, s.run, s.unit_of_measure, s.samples, s.irregular, t_first_ns, t_last_ns, sample_interval_s,
  coalesce(r.date_known, true) as date_known
from internal.served_signals s left join internal.served_runs r using (run)
where $unit is null or (s.unit = $unit and s.signal = $signal and s.run = $run)
"""
_PARTS = """
select unit, signal, run, channel, is_kept, filename, samples, t_first_ns, t_last_ns, is_counts, scale, "offset"
from internal.served_parts where $unit is null or (unit = $unit and signal = $signal and run = $run)
order by t_first_ns
"""
_OF_UNITS = """
select s.unit, s.signal, any_value(s.unit_of_measure) as unit_of_measure, count(distinct s.run) as runs,
  coalesce(any_value(e.curves), 0) as curves
from internal.served_signals s left join (
  select unit, signal, count(distinct run) as curves from internal.lake_estimates
  where ($unit is null or unit = $unit) and estimator = 'allan_deviation' group by all
) e using (unit, signal)
where $unit is null or s.unit = $unit group by s.unit, s.signal order by s.signal
"""
_NAMES = ("unit", "signal", "run")


class RecordedSignal(NamedTuple):
    """A signal of a run in the lake: None if it is not there; and the parts that have it, by time."""

    about: Mapping[str, Any] | None
    parts: list[dict[str, Any]]


_NOT_THERE = RecordedSignal(None, [])


def recorded_signal(call: Call, unit: str, signal: str, run: str) -> RecordedSignal:
    """What the lake has of a signal of a run."""
    name = {"unit": unit, "signal": signal, "run": run}
    if _is_small(call):
        every: dict[tuple[str, ...], RecordedSignal] = call.service.memo.newest(
            "signals", call.state.tag, lambda: _recorded(call, dict.fromkeys(_NAMES))
        )
        return every.get((unit, signal, run), _NOT_THERE)
    found: RecordedSignal = call.service.of_units.result(
        ("signal", *name.values(), call.state.tag), lambda: _recorded(call, name).get((unit, signal, run), _NOT_THERE)
    )
    return found


def signals_of(call: Call, unit: str) -> Mapping[str, dict[str, Any]]:
    """Signals of a unit in the lake, with how many runs they are of, and in how many of these they were estimated."""
    found: Mapping[str, dict[str, Any]]
    if _is_small(call):
        every: Mapping[str, Mapping[str, dict[str, Any]]] = call.service.memo.newest(
            "signals of units", call.state.tag, lambda: _of_units(call, None)
        )
        found = every.get(unit, {})
    else:
        found = call.service.of_units.result(
            ("signals", unit, call.state.tag), lambda: _of_units(call, unit).get(unit, {})
        )
    return found


def _is_small(call: Call) -> bool:
    return bool(call.service.memo.result(
        ("few parts", call.state.tag), lambda: call.views.rows(_COUNT)[0][0] <= _MOST_PARTS
    ))  # fmt: skip


def _recorded(call: Call, name: Mapping[str, str | None]) -> dict[tuple[str, ...], RecordedSignal]:
    parts: dict[tuple[str, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in dictionaries(call.views, _PARTS, name):
        parts[row["unit"], row["signal"], row["run"]].append(row)
    return {
        key: RecordedSignal(row, parts[key])
        for row in dictionaries(call.views, _ABOUT, name)
        for key in [(row["unit"], row["signal"], row["run"])]
    }


def _of_units(call: Call, unit: str | None) -> dict[str, dict[str, dict[str, Any]]]:
    found: dict[str, dict[str, dict[str, Any]]] = defaultdict(dict)
    for row in dictionaries(call.views, _OF_UNITS, {"unit": unit}):
        found[row["unit"]][row["signal"]] = row
    return dict(found)
