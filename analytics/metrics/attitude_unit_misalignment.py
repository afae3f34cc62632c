"""Misalignments of an attitude unit: what an axis sees of whole turns about another (JJF 1536-2015 7.3)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from analytics.methods.attitude.cross_axes import Element, Elements, element_name
from analytics.methods.attitude.positions import triad_of
from storage.sql.catalog import Catalog
from stream.errors import BadInput

ARCMIN_PER_RAD = 10800 / math.pi
# Of a turn: what is left of it sees the level part of the Earth's rate, 0.0004 deg of it at 100 deg/s.
_WHOLE = 0.02
_TURNS = 'from internal.attitude_turns order by run, unit, repeat nulls first, "index", signal'
# standard deviation of the means of whole turns
_SPREAD = """
with turns as (
  select w.run, w.unit, w.signal, w."index", (s.t_ns - w.t_from_ns) // w.turn_ns as turn, avg(s.value) as mean
  from internal.attitude_windows w
  join internal.samples_in($paths) s
    on s.run = w.run and s.unit = w.unit and s.signal = w.signal
    and s.t_ns >= w.t_from_ns and s.t_ns < w.t_from_ns + (w.t_to_ns + 1 - w.t_from_ns) // w.turn_ns * w.turn_ns
  where s.run in (select run from internal.attitude_windows) and s.unit in (select unit from internal.attitude_windows)
  group by all
)
select run, unit, signal, "index", count(*), stddev_samp(mean) from turns group by all
"""
_LEAST_MEANS = 3
_LEAST_TURNS = 10
_LEAST_HZ = 10.0

Step = Mapping[str, Any]


class Turning(NamedTuple):
    """Steps that turn about an axis in one direction."""

    rate: float  # about the axis, with its sign, deg/s
    turns: float
    turns_by: str  # ``table``, ``command`` or ``own axis``


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: each of the six elements for every rate and repeat, or why there is none."""
    steps = catalog.reader(sql).read_all().to_pylist()
    _by_turns(catalog, steps)
    for (run, unit, repeat), group in groupby(steps, itemgetter("run", "unit", "repeat")):
        rows = list(group)
        signals = {row["own"]: row["signal"] for row in rows}
        for own, signal in sorted(signals.items()):
            mine = [row for row in rows if row["own"] == own]
            for turned in (axis for axis in triad_of(own) if axis != own):
                about = [row for row in mine if row["turned"] == turned]
                for rate in sorted({abs(row["rate_command"]) for row in about}) or [None]:
                    chosen = [row for row in about if abs(row["rate_command"]) == rate]
                    common = {"run": run, "unit": unit, "signal": signal}
                    yield common | _of_element(own, turned, rate, repeat, chosen or mine, rows)


def _by_turns(catalog: Catalog, steps: Sequence[dict[str, Any]]) -> None:
    """Give steps of whole turns the uncertainty that the scatter of the turns' means has.

    Within a turn the level part of the Earth's rate goes round once; in the scatter of all samples it would count as
    noise. Angles, and steps whose samples the store no longer has, keep theirs.
    """
    windows = [
        {"run": step["run"], "unit": step["unit"], "signal": step["signal"], "index": step["index"],
         "t_from_ns": step["t_from_ns"], "t_to_ns": step["t_to_ns"], "turn_ns": round(360e9 / abs(step["rate"]))}
        for step in steps
        if step["rate"] and step["deg_per_s"] is not None
        and step["turned"] != step["own"] and not step["is_integrated"]
    ]  # fmt: skip
    if not windows:
        return
    catalog.put("attitude_windows", pa.Table.from_pylist(windows))
    given = {"paths": catalog.checked_paths_of({each["run"] for each in windows}, _SPREAD)}
    found = {tuple(key): (turns, spread) for *key, turns, spread in catalog.rows(_SPREAD, given)}
    for step in steps:
        turns, spread = found.get((step["run"], step["unit"], step["signal"], step["index"]), (0, None))
        if turns >= _LEAST_MEANS and spread is not None:
            step["u"], step["freedom"] = spread * abs(step["deg_per_s"]) / math.sqrt(turns), turns - 1.0


def latest_elements(catalog: Catalog) -> Elements:
    """The elements of each unit, by unit and name, from the last run that has one; at several rates the fastest."""
    began = dict(catalog.rows("select run, max(t_to_ns) from step_means group by run"))
    rows = [row for row in compute(catalog, _TURNS) if "value" in row]
    rows.sort(key=lambda row: (began.get(row["run"], 0), row["parameters"]["rate_deg_per_s"]))
    return {
        (row["unit"], row["parameters"]["element"]): Element(
            row["value"] / ARCMIN_PER_RAD, row["standard_uncertainty"] / ARCMIN_PER_RAD, row["freedom"]
        )
        for row in rows
    }


def _of_element(
    own: str, turned: str, rate: float | None, repeat: int | None, chosen: Sequence[Step], rows: Sequence[Step]
) -> dict[str, Any]:
    words: dict[str, Any] = {
        "element": element_name(own, turned), "turned_axis": turned, "output_axis": own, "rate_deg_per_s": rate,
        "turns": None, "turns_by": None, "radians": None, "repeat": repeat, "scale_factor": chosen[0]["scale_source"],
        "remark": None,
    }  # fmt: skip
    clause = f"5.{6 + 'XYZ'.find(turned)} ({7 + 'XYZ'.find(turned)})" if turned in "XYZ" else "5.6-5.8 (7)-(9)"
    row = {
        "n": sum(step["n"] for step in chosen), "steps": sorted(step["index"] for step in chosen), "parameters": words,
        "standard": "JJF1536", "clause": f"{clause}, 7.3.2 (17)",
    }  # fmt: skip
    try:
        if rate is None:
            raise BadInput(_not_turned(own, turned, rows))
        if chosen[0]["no_scale"] is not None:
            raise BadInput(chosen[0]["no_scale"])
        ways = [_way(sign, turned, chosen, rows) for sign in (1, -1)]
        if not any(step["mean"] or step["sd"] for step in chosen):
            raise BadInput("the output is 0 in every sample of every turn: the axis does not answer")
        found = _element([step for step in chosen if step["rate_command"] > 0],
                         [step for step in chosen if step["rate_command"] < 0], *ways)  # fmt: skip
    except BadInput as error:
        return row | {"reason": str(error)}
    words |= {
        "turns": round(min(way.turns for way in ways), 3), "turns_by": ways[0].turns_by,
        "radians": float(f"{found.value:.7g}"), "remark": _remark(chosen, min(way.turns for way in ways)),
    }  # fmt: skip
    return row | {
        "value": found.value * ARCMIN_PER_RAD, "standard_uncertainty": found.u * ARCMIN_PER_RAD,
        "freedom": found.freedom,
    }  # fmt: skip


def _remark(steps: Sequence[Step], turns: float) -> str | None:
    """What departs from 7.3.1 b without being refused: its note leaves the number of turns to an agreement."""
    found = [] if turns >= _LEAST_TURNS else [f"{turns:g} turns: the clause has {_LEAST_TURNS}"]
    slowest = min((step["n"] - 1) / step["duration_s"] if step["duration_s"] else 0.0 for step in steps)
    if slowest < _LEAST_HZ * 0.99:
        found.append(f"{slowest:.3g} samples/s: 7.3.1 asks for at least {_LEAST_HZ:.0f}")
    return "; ".join(found) or None


def _not_turned(own: str, turned: str, rows: Sequence[Step]) -> str:
    about = {row["turned"] for row in rows}
    if None in about:
        return "no word says which axis was turned: add a column axis, or positions X_up, Y_up, Z_up"
    if strangers := sorted(about - set(triad_of(own))):
        return (
            f"the turned axes are called {', '.join(strangers)}, and the output is of {own}: name the axes of steps as "
            f"those of the signals; 5.3 to 5.5 and annex B put heading, pitch and roll on different letters"
        )
    return f"not measured in this run: turns about {turned} (7.3.1)"


def _way(sign: int, turned: str, chosen: Sequence[Step], rows: Sequence[Step]) -> Turning:
    """The rate and the whole turns of one direction.

    The turns are those of the table where it was measured; else of the command, or where the record holds the
    acceleration too, those that the turned axis itself counts.
    """
    steps = [step for step in chosen if step["rate_command"] * sign > 0]
    if not steps:
        raise BadInput(f"turns about {turned} in one direction only: the bias does not cancel (7.3.1 c)")
    rates = np.array([step["rate"] for step in steps])
    found = Turning(float(rates.mean()), _turns(steps, rates), str(steps[0]["input_rate_source"] or "command"))
    if found.turns_by != "table" and not _is_whole(steps, rates):
        by_index = {row["index"]: row["output"] for row in rows if row["own"] == turned and row["output"] is not None}
        own = np.array([by_index.get(step["index"], math.nan) for step in steps])
        if _is_whole(steps, own):
            found = Turning(float(own.mean()), _turns(steps, own), "own axis")
            rates = own
    if not _is_whole(steps, rates):
        raise BadInput(
            f"{found.turns:.3f} turns about {turned} at {found.rate:g} deg/s were recorded, whole turns are asked for: "
            f"the level part of the Earth's rate is left over from a part of one (5.6, 7.3.1 b)"
        )
    return found._replace(turns=float(round(found.turns)))


def _turns(steps: Sequence[Step], rates: Any) -> float:
    lasts_s = np.array([step["duration_s"] * step["n"] / max(step["n"] - 1, 1) for step in steps])
    return float((np.abs(rates) * lasts_s / 360.0).mean())


def _is_whole(steps: Sequence[Step], rates: Any) -> bool:
    """Whether each record holds whole turns, but for one sample: its end is its last sample, or a sample later."""
    for step, rate in zip(steps, np.abs(rates), strict=True):
        shortest = rate * step["duration_s"] / 360.0
        longest = shortest * step["n"] / max(step["n"] - 1, 1)
        if not math.isfinite(longest):
            return False
        whole = round((shortest + longest) / 2)
        if not (whole >= 1 and shortest - _WHOLE <= whole <= longest + _WHOLE):
            return False
    return True


def _element(forwards: Sequence[Step], backwards: Sequence[Step], way: Turning, back: Turning) -> Element:
    """L = (N+ - N-)/(2 360 n) as the ratio of mean rates: N = rate T, 360 n = rate of the table T."""
    mean, variance, fourth = [], 0.0, 0.0
    for steps in (forwards, backwards):
        mean.append(math.fsum(step["output"] for step in steps) / len(steps))
        for step in steps:
            own = math.nan if step["u"] is None else (step["u"] / len(steps)) ** 2
            variance += own
            fourth += own**2 / max(step["freedom"] or 1.0, 1.0)
    turned = way.rate - back.rate
    freedom = variance**2 / fourth if fourth > 0 else 1e9
    return Element((mean[0] - mean[1]) / turned, math.sqrt(variance) / abs(turned), freedom)
