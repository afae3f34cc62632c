"""Pictures of a unit: characteristics over time against their limits, Allan curves of its runs, temperature."""

import json
from collections import defaultdict
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from analytics.methods.distributions import student_quantile
from analytics.plots.picture import Axis, Curve, Label, Picture
from analytics.serve.api.operation import Call, get, link
from analytics.serve.api.query.recorded_signals import signals_of
from analytics.serve.api.rows import Name, dictionaries
from analytics.serve.api.unit.units import unit_row
from analytics.trends.values_sql import METRIC_VALUES
from stream.errors import NotFound, UnknownUnit
from stream.quantities import is_angular_rate, report_unit, result_factor

_MOST_CURVES = 12
_VALUES = f"""
with judged as (
  select unit, metric, signal, run, standard, parameters, lower, upper, verdict, specification, revision,
    unit_of_measure as limit_unit
  from verdicts where unit = $unit and metric = $metric
)
select m.signal, m.run, m.value, m.lo, m.hi, m.unit_of_measure, m.standard, m.parameters, m.t_ns, m.date_known,
  j.lower, j.upper, j.limit_unit, j.verdict, j.specification || '-' || j.revision as specification
from ({METRIC_VALUES}) m
left join judged j on j.signal is not distinct from m.signal and j.run is not distinct from m.own_run
  and j.standard is not distinct from m.standard and j.parameters is not distinct from m.parameters
where m.value is not null and ($signal = '' or m.signal = $signal)
order by m.t_ns nulls last, m.run
"""  # noqa: S608  our own statement
_ALLAN = """
select e.run, e.tau_s, e.value, e.lo, e.hi, e.unit_of_measure, e.final
from estimates e join (
  select run, max(t_first_ns) as t_ns from internal.served_signals
  where unit = $unit and signal = $signal group by run
) s using (run)
where e.unit = $unit and e.signal = $signal and e.estimator = 'allan_deviation' and e.tau_s is not null
qualify e.t_ns = max(e.t_ns) over (partition by e.run)
order by s.t_ns desc, e.run, e.tau_s
"""
_STEPS = """
select run, step, temperature, bias, standard_uncertainty, freedom from temperature_curve
where unit = $unit and signal = $signal order by run, temperature
"""
_WITH_STEPS = "select distinct unit from temperature_curve"
# 10 s means at rest by temperature; buckets in which the table turns, or is commanded to, are left out
_SWEEPS = """
with rate as (
  select run, t_ns, mean from rollup_10s where unit = $unit and signal = $signal
), warmth as (
  select run, t_ns, mean as temperature from rollup_10s where unit = $unit and signal = $temperature
), turning as (
  select distinct run, t_ns from rollup_10s
  where signal in ('input_rate', 'table_rate') and run in (select run from rate)
    and greatest(abs(lo), abs(hi)) > 0.01
), commanded as (
  select run, t_start_ns, t_end_ns from steps where unit = $unit and abs(rate_command) > 0.0
), still as (
  select r.run, r.mean, w.temperature from rate r join warmth w using (run, t_ns)
  anti join turning t on t.run = r.run and t.t_ns = r.t_ns
  anti join commanded c on c.run = r.run and r.t_ns + 10000000000 > c.t_start_ns and r.t_ns < c.t_end_ns
), spread as (
  select run, min(temperature) as low,
    greatest((max(temperature) - min(temperature)) / least(30, greatest(count(*) // 4, 3)), 0.1) as width
  from still
  group by run having max(temperature) - min(temperature) >= 3
)
select s.run, avg(s.temperature) as temperature, avg(s.mean) as mean, stddev_samp(s.mean) as deviation, count(*) as n,
  floor((s.temperature - p.low) / p.width)::int as class
from still s join spread p using (run)
group by s.run, class having count(*) >= 2 order by s.run, temperature
"""
_RESULTS = {
    "duration_s", "whole_seconds", "n_effective", "repeat", "repeats", "scale_factor", "scale_source", "epochs", "days",
    "power_ons", "n", "remark", "misfit", "record", "temperature",
}  # fmt: skip
_TEMPERATURES = ("temperature", "case_temperature", "chamber_temperature")


class HistoryAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which characteristic, as ``bias``; of which signal, by default of each."""

    metric: Name
    signal: Name = ""


class OfSignal(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which signal; by default the first angular rate."""

    signal: Name = ""


@get("/api/units/{unit}/history", table="", is_slow=True)
def unit_history(call: Call, asked: HistoryAsked) -> Picture:
    """A characteristic of a unit over time, each value with its 95 % bounds, against the limits valid at the time."""
    from analytics.metric_registry.registry import alike, check_metrics, metrics

    check_metrics((asked.metric,))
    unit, header = call.path["unit"], metrics()[asked.metric].header
    unit_row(call, unit)
    given = {"unit": unit, "metric": asked.metric, "signal": asked.signal}
    rows = [_in_one_unit(row) for row in dictionaries(call.metrics, _VALUES, given)]
    if asked.signal and not rows and asked.signal not in (known := signals_of(call, call.path["unit"])):
        raise NotFound(
            f"unit {unit!r} has no signal {asked.signal!r}; {alike(asked.signal, list(known), 'signals are')}"
        )
    dated = bool(rows) and all(row["date_known"] and row["t_ns"] is not None for row in rows)
    title, measure = Label(header.en, header.zh), rows[0]["unit_of_measure"] if rows else header.unit
    runs = list(dict.fromkeys(row["run"] or "" for row in rows))
    x = Axis(label=Label("time (UTC)", "时间（UTC）"), scale="time")
    if not dated:
        x = Axis(label=Label("run", "试验"), scale="names", names=[Label.same(run) for run in runs])
    y = Axis(label=title, unit=measure)
    if not rows:
        why = Label("No completed step gives this characteristic a value.", "没有已完成的步骤给出该特性的数值。")
        return Picture(title=title, x=x, y=y, reason=why)
    by_kind: dict[str, list[tuple[float, dict[str, Any]]]] = defaultdict(list)
    for row in rows:
        by_kind[_kind(row)].append((row["t_ns"] / 1e9 if dated else float(runs.index(row["run"] or "")), row))
    # a limit is of one kind of values, as of one averaging time: others beside it would look judged by it
    limited = {kind: points for kind, points in by_kind.items() if any(_has_limit(row) for _, row in points)}
    shown = dict(list((limited or by_kind).items())[:_MOST_CURVES])
    left = len(by_kind) - len(shown)
    note = Label(
        f"{left} kinds of this characteristic without a limit are not drawn; they are in the table of characteristics.",
        f"该特性的 {left} 类无限值的数值未绘出，见特性表。",
    )
    curves = [_values(kind, points) for kind, points in shown.items()]
    return Picture(title=title, x=x, y=y, curves=[*curves, *_limits(shown)], note=note if left else None)


@get("/api/units/{unit}/allan", table="", is_slow=True)
def unit_allan(call: Call, asked: OfSignal) -> Picture:
    """Allan deviation of a unit's signal in each of its runs, with 95 % bounds; the newest runs first, 12 at most."""
    unit = call.path["unit"]
    signal = _signal_of(call, asked.signal)
    given = {"unit": unit, "signal": signal}
    by_run: dict[str, list[dict[str, Any]]] = defaultdict(list)
    known = signals_of(call, call.path["unit"]).get(signal)
    for row in dictionaries(call.views, _ALLAN, given) if known is not None and known["curves"] else ():
        by_run[row["run"]].append(row)
    runs = 0 if known is None else known["runs"]
    measure = next(iter(by_run.values()))[0]["unit_of_measure"] if by_run else ""
    curves = [
        Curve(
            name=Label.same(run), x=[row["tau_s"] for row in rows], y=[row["value"] for row in rows], style="both",
            lo=[row["lo"] for row in rows], hi=[row["hi"] for row in rows],
            links=[link("signals", unit, run, signal)] * len(rows),
        )
        for run, rows in list(by_run.items())[:_MOST_CURVES]
    ]  # fmt: skip
    shown, without = len(curves), runs - len(by_run)
    note = Label(
        f"{shown} of {runs} runs; {without} have no estimate of the run: the page of their signal computes it.",
        f"共{runs}次试验，显示{shown}次；{without}次没有试验中的估计，可在其信号页面计算。",
    )
    none = Label("No run of this signal has an Allan deviation yet.", "该信号尚无试验有 Allan 标准差。")
    return Picture(
        title=Label(f"Allan deviation of {signal}", f"{signal} 的 Allan 标准差"),
        x=Axis(label=Label("averaging time", "平均时间"), unit="s", scale="log"),
        y=Axis(label=Label("Allan deviation", "Allan 标准差"), unit=measure, scale="log"),
        curves=curves, note=note if shown < runs else None, reason=None if curves else none,
    )  # fmt: skip


@get("/api/units/{unit}/temperature", table="", is_slow=True)
def unit_temperature(call: Call, asked: OfSignal) -> Picture:
    """Output of a unit at rest over temperature: bias of static steps, 10 s means of runs whose temperature moves."""
    unit = call.path["unit"]
    signal = _signal_of(call, asked.signal)
    known = {name: row["unit_of_measure"] for name, row in signals_of(call, call.path["unit"]).items()}
    measure, factor = report_unit(known.get(signal, ""))
    curves: list[Curve] = []
    by_run: dict[str, list[dict[str, Any]]] = defaultdict(list)
    with_steps = call.service.memo.result(
        ("with steps", call.metrics_tag), lambda: frozenset(name for (name,) in call.metrics.rows(_WITH_STEPS))
    )
    for row in dictionaries(call.metrics, _STEPS, {"unit": unit, "signal": signal}) if unit in with_steps else ():
        by_run[row["run"]].append(row)
    curves += [_steps(Label(f"{run}: steps", f"{run}：步骤"), rows) for run, rows in by_run.items() if len(rows) > 1]
    if alone := [rows[0] for rows in by_run.values() if len(rows) == 1]:
        curves.append(_steps(Label("single steps of runs", "各试验的单个步骤"), alone))
    temperature = next((name for name in _TEMPERATURES if name in known), None)
    curves += _sweeps(call, unit, signal, temperature, factor) if temperature is not None else []
    none = Label(
        "No static step, and no run whose temperature moves by 3 °C or more, gives the bias over temperature; a static "
        "step needs a signal temperature or a commanded temperature.",
        "没有静态步骤或温度变化达到 3 °C 的试验能给出零偏随温度的变化；静态步骤须有信号 temperature 或指令温度。",
    )
    note = Label(
        "Points of steps: bias with its 95 % bounds. Curves of runs: means of 10 s at rest in classes of temperature; "
        "bars: their standard deviation.",
        "步骤点：零偏及其 95 % 区间。试验曲线：静止时 10 s 均值按温度分级；误差棒为其标准差。",
    )
    return Picture(
        title=Label("Bias over temperature", "零偏随温度的变化"),
        x=Axis(label=Label(temperature or "temperature", "温度"), unit="degC"),
        y=Axis(label=Label("output at rest", "静止输出"), unit=measure),
        curves=curves[:_MOST_CURVES], note=note if curves else None, reason=None if curves else none,
    )  # fmt: skip


def _steps(name: Label, rows: list[dict[str, Any]]) -> Curve:
    """Bias of static steps with its 95 % bounds."""
    u, freedom = (np.array([row[name] for row in rows], np.float64) for name in ("standard_uncertainty", "freedom"))
    found = u * student_quantile(0.975, np.clip(np.nan_to_num(freedom, nan=1e9), 1.0, 1e9))
    half = [None if each != each else each for each in found.tolist()]
    is_one_run = len({row["run"] for row in rows}) == 1
    return Curve(
        name=name, x=[row["temperature"] for row in rows], y=[row["bias"] for row in rows],
        style="both" if is_one_run else "points",
        lo=[None if each is None else row["bias"] - each for row, each in zip(rows, half, strict=True)],
        hi=[None if each is None else row["bias"] + each for row, each in zip(rows, half, strict=True)],
        texts=[f"{row['run']} {row['step']}" for row in rows], links=[link("runs", row["run"]) for row in rows],
    )  # fmt: skip


def _sweeps(call: Call, unit: str, signal: str, temperature: str, factor: float) -> list[Curve]:
    by_run: dict[str, list[dict[str, Any]]] = defaultdict(list)
    given = {"unit": unit, "signal": signal, "temperature": temperature}
    for row in dictionaries(call.views, _SWEEPS, given):
        by_run[row["run"]].append(row)
    return [
        Curve(
            name=Label.same(run), x=[row["temperature"] for row in rows], y=[_scaled(row, factor) for row in rows],
            style="both", lo=[_scaled(row, factor, -1.0) for row in rows],
            hi=[_scaled(row, factor, 1.0) for row in rows], links=[link("signals", unit, run, signal)] * len(rows),
        )
        for run, rows in ((run, _with_gaps(rows)) for run, rows in by_run.items())
    ]  # fmt: skip


def _with_gaps(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of classes of temperature, with an empty one where classes lie between that nothing was measured in.

    >>> rows = [{"class": at, "temperature": float(at), "mean": 1.0, "deviation": 0.1} for at in (0, 1, 5)]
    >>> [(row["temperature"], row["mean"]) for row in _with_gaps(rows)]
    [(0.0, 1.0), (1.0, 1.0), (3.0, None), (5.0, 1.0)]
    """
    found = rows[:1]
    for before, row in pairwise(rows):
        if row["class"] > before["class"] + 1:
            middle = (before["temperature"] + row["temperature"]) / 2
            found.append({"temperature": middle, "mean": None, "deviation": None})
        found.append(row)
    return found


def _scaled(row: dict[str, Any], factor: float, deviations: float = 0.0) -> float | None:
    """The mean of a class, or a bound some standard deviations from it; None of an empty class."""
    if row["mean"] is None:
        return None
    return float((row["mean"] + deviations * (row["deviation"] or 0.0)) * factor)


def _signal_of(call: Call, asked: str) -> str:
    """The signal that is asked for, else the first angular rate with curves, else the first of all."""
    unit = call.path["unit"]
    unit_row(call, unit)
    if asked:
        return asked
    known = list(signals_of(call, call.path["unit"]).values())
    known.sort(key=lambda row: (not is_angular_rate(row["unit_of_measure"]), not row["curves"], row["signal"]))
    return known[0]["signal"] if known else ""


def _kind(row: dict[str, Any]) -> str:
    """What distinguishes values of one characteristic: signal, standard, settings."""
    parameters = json.loads(row["parameters"] or "{}")
    settings = [f"{name}={value}" for name, value in parameters.items() if name not in _RESULTS and value is not None]
    return ", ".join(each for each in (row["signal"], row["standard"], *settings) if each)


def _in_one_unit(row: dict[str, Any]) -> dict[str, Any]:
    """A value with its limits in its own unit of measure; without them where they are of another quantity."""
    if not _has_limit(row) or row["limit_unit"] == row["unit_of_measure"]:
        return row
    try:
        factor = result_factor(row["limit_unit"], row["unit_of_measure"])
    except UnknownUnit:
        return row | {"lower": None, "upper": None}
    return row | {side: None if row[side] is None else row[side] * factor for side in ("lower", "upper")}


def _has_limit(row: dict[str, Any]) -> bool:
    return row["lower"] is not None or row["upper"] is not None


def _values(kind: str, points: list[tuple[float, dict[str, Any]]]) -> Curve:
    return Curve(
        name=Label.same(kind), x=[x for x, _ in points], y=[row["value"] for _, row in points], style="both",
        lo=[row["lo"] for _, row in points], hi=[row["hi"] for _, row in points],
        texts=[row["run"] or "" for _, row in points],
        links=[link("runs", row["run"]) if row["run"] else None for _, row in points],
        verdicts=[row["verdict"] for _, row in points],
    )  # fmt: skip


def _limits(by_kind: dict[str, list[tuple[float, dict[str, Any]]]]) -> list[Curve]:
    """Limits as they were valid at each value, one curve for each side of each specification."""
    curves = []
    points = [each for of_kind in by_kind.values() for each in of_kind]
    for side, name in (("lower", Label("lower limit", "下限")), ("upper", Label("upper limit", "上限"))):
        levels: dict[str, dict[float, float]] = defaultdict(dict)
        for place, row in points:
            if row[side] is not None:
                levels[row["specification"] or ""][place] = row[side]
        curves += [
            Curve(
                name=Label(f"{name.en} {which}".strip(), f"{name.zh} {which}".strip()), x=sorted(of),
                y=[of[each] for each in sorted(of)], style="limit",
            )
            for which, of in levels.items()
        ]  # fmt: skip
    return curves
