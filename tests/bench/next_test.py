"""Does the recommended test decide? Confounded campaigns, the test that is recommended, and the diagnosis after it.

    .venv/bin/python -m tests.bench.next_test [--design rates] [--count 6] [--first 0] [--json]

Each case plants one effect in a design that leaves it confounded. The plan with the least hours that states a power of
90 % or more is simulated with the truth at work, by the physics of `loop_drives`, and added to the training runs. It
counts as decided if the diagnosis then has the truth as its only name. Stated power is that of the truth.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.next_test.plans import TestPlan
from analytics.loop.next_test.recommendation import next_test
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.next_test.timeline import STEP_S, Timeline, timeline
from analytics.loop.tracing.diagnosis import diagnose
from tests.bench.loop_campaign import Campaign, Planted
from tests.bench.loop_drives import SENSOR_NOISE, Drive, physics_of
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in


class Design(NamedTuple):
    """A campaign of runs that leave the effects of some family confounded.

    Parameters
    ----------
    bounds: Of the station, beyond what the runs show.
    """

    types: tuple[str, ...]
    runs: int
    duration_s: float
    effects: tuple[str, ...]
    bounds: Mapping[str, float] = MappingProxyType({})


_THERMAL = ("temperature_squared", "thermal_lag", "drift_in_run", "temperature_cubed", "thermal_hysteresis")
_CHAMBER = {"least_deg_c": -10.0, "most_deg_c": 60.0}
DESIGNS = {
    "ramp": Design(("ramp",), 9, 21600.0, _THERMAL),
    "rates": Design(
        ("two_rates",), 6, 7200.0, ("scale_factor_asymmetry", "scale_factor_quadratic", "rate_product_io")
    ),
    "one_way": Design(("one_way",), 6, 7200.0, ("scale_factor_quadratic", "scale_factor_cubic", "saturation")),
    "positions": Design(
        ("three_positions",), 6, 7200.0, ("gravity_i", "gravity_i_squared", "gravity_o", "gravity_s_squared")
    ),
    "supply": Design(
        ("supply_ramp",), 6, 7200.0,
        ("supply_voltage", "drift_in_run", "temperature_squared", "thermal_hysteresis"),
        _CHAMBER,
    ),
    "power_on": Design(("power_on",), 6, 7200.0, ("warm_up", "drift_in_run", "temperature_squared"), _CHAMBER),
    "heading": Design(
        ("two_headings",), 6, 7200.0, ("heading", "table_angle_harmonic_1", "table_angle_harmonic_2"),
        {"least_angle_deg": 0.0, "most_angle_deg": 360.0},
    ),
}  # fmt: skip
Z = 14.0
_AXES = {"IRA": (1.0, 0.0, 0.0), "OA": (0.0, 1.0, 0.0), "SA": (0.0, 0.0, 1.0)}


def planned_runs(
    campaign: Campaign, plan: TestPlan, planted: Planted, bounds: StationBounds, seed: int
) -> list[RunBlocks]:
    """The runs of a plan with an effect at work; each power-on is a run of its own, as the reduction makes it."""
    played = timeline(plan.test, bounds)
    done = Campaign(seed, runs=plan.test.repeats, types=("static",), duration_s=_whole(played) * campaign.block_s)
    last = max(each.day for each in campaign.drives)
    for number in range(plan.test.repeats):
        rng = np.random.default_rng((seed, 5, number))
        done.drives[number] = _driven(played, done.drives[number].time_s, last + 1.0 + number, rng)
        done.names[number] = f"next-{number + 1}"
        powered = np.interp(done.drives[number].time_s, played.time_s, played.is_powered.astype(float)) > 0.99
        whole = powered.reshape(-1, round(campaign.block_s / campaign.step_s)).all(axis=1)
        position = np.array(_positions(played, done.drives[number].time_s)).reshape(whole.size, -1)
        whole &= (position == position[:, :1]).all(axis=1)
        done.slots[number] = np.flatnonzero(whole)
    return [part for run in done.runs([planted]) for part in _by_power_on(run)]


def _by_power_on(run: RunBlocks) -> list[RunBlocks]:
    number = np.cumsum(np.diff(run.mean("time_since_power_on"), prepend=0.0) < 0.0)
    if number[-1] == 0:
        return [run]
    return [replace(run.part(number == each), run=f"{run.run}#{each + 1}") for each in range(number[-1] + 1)]


def _whole(played: Timeline) -> int:
    return int(played.time_s[-1] // 30.0)


def _driven(played: Timeline, time_s: Any, day: float, rng: np.random.Generator) -> Drive:
    asked = {"table_rate": np.interp(time_s, played.time_s, played.rate_deg_per_s)}
    if np.isfinite(played.setpoint_deg_c).any():
        known = np.isfinite(played.setpoint_deg_c)
        asked["setpoint"] = np.interp(time_s, played.time_s[known], played.setpoint_deg_c[known])
    if np.isfinite(played.angle_deg).all():
        asked["angle0"] = np.zeros(time_s.size)
    if np.isfinite(played.volts).all():
        asked["supply_voltage"] = np.interp(time_s, played.time_s, played.volts)
    if any(played.position):
        axes = {word: np.array(_vertical(word)) for word in set(played.position)}
        asked["orientation"] = np.array([axes[word] for word in _positions(played, time_s)])
    since = np.interp(time_s, played.time_s, np.nan_to_num(played.since_power_on_s))
    true = physics_of(time_s, asked, since, rng) | {"day": day + time_s / 86400.0}
    read = {
        name: values + SENSOR_NOISE.get(name, 0.0) * rng.standard_normal(time_s.size) for name, values in true.items()
    }
    return Drive("next", time_s, day, true, read)


def _positions(played: Timeline, time_s: Any) -> list[str]:
    at = np.minimum((time_s / STEP_S).astype(int), len(played.position) - 1)
    return [played.position[each] for each in at]


def _vertical(word: str) -> tuple[float, ...]:
    """Components of the vertical in a position; with the input axis horizontal the output axis is up."""
    axis, _, towards = word.partition("_")
    if towards == "horizontal":
        return _AXES["OA"]
    return tuple((-1.0 if towards == "down" else 1.0) * each for each in _AXES[axis])


def tried(design: str, name: str, number: int) -> dict[str, Any]:
    """One case; ``skipped`` if its design does not leave it confounded."""
    made = DESIGNS[design]
    campaign = Campaign(4000 + number, types=made.types, runs=made.runs, duration_s=made.duration_s)
    planted = planted_in(campaign, name, Z, np.random.default_rng((number, 3)))
    before = campaign.runs([planted], noise_seed=7000 + number)
    found = diagnose(before, MODEL, declared_noise=DECLARED)
    bounds = StationBounds.of_runs(before, None, **dict(made.bounds))
    asked = next_test(found, before, MODEL, declared_noise=DECLARED, bounds=bounds)
    line: dict[str, Any] = {"design": design, "effect": name, "seed": number}
    if (
        asked is None
        or asked.question != "which"
        or name not in {*asked.rivals, *(each for alike in asked.twins.values() for each in alike)}
    ):
        return line | {"skipped": "" if asked is None else asked.question, "named": list(found.names)}
    line |= {"rivals": list(asked.rivals), "twins": {each: list(alike) for each, alike in asked.twins.items()}}
    plan = next((each for each in asked.plans if not each.test.like), None)
    if plan is None or name not in asked.rivals:
        return line | {"plan": None, "why_not": asked.why_not and str(asked.why_not)}
    added = planned_runs(campaign, plan, planted, bounds, 9000 + number)
    after = diagnose([*before, *added], MODEL, declared_noise=DECLARED, holdout=asked.holdout)
    single = [each for each in after.effects if not each.confounded]
    twins = set(asked.twins.get(name, ()))
    left = {each.name for of in after.effects for each in of.confounded}
    is_single = [each.name for each in after.effects] == [name] and (len(single) == 1 or left <= twins)
    return line | {
        "plan": plan.test.name,
        "runs": plan.test.repeats,
        "hours": plan.hours,
        "stated": plan.power,
        "stated_least": plan.assured,
        "stated_of_truth": plan.by_truth[name],
        "repeat_hours": None if asked.repeat is None else asked.repeat.hours,
        "verdict": after.verdict.value,
        "decided": is_single,
        "names": [[each.name, [other.name for other in each.confounded]] for each in after.effects],
        "again": [each.name for each in after.unreplicated],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=6, help="seeds of each effect")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--design", choices=sorted(DESIGNS), action="append")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each case")
    given = parser.parse_args(arguments)
    lines = []
    for number in range(given.first, given.first + given.count):
        for design in given.design or DESIGNS:
            for name in DESIGNS[design].effects:
                line = tried(design, name, number)
                if "skipped" not in line:
                    lines.append(line)
                if given.json or "skipped" not in line:
                    print(json.dumps(line) if given.json else line, flush=True)
    planned = [line for line in lines if line["plan"]]
    if not planned:
        sys.exit("no confounded case has a plan")
    stated = float(np.mean([line["stated_of_truth"] for line in planned]))
    achieved = float(np.mean([line["decided"] for line in planned]))
    hours = float(np.mean([line["hours"] for line in planned]))
    repeat = [line["repeat_hours"] for line in planned if line["repeat_hours"] is not None]
    print(
        f"{len(lines)} confounded cases, {len(planned)} with a plan of {hours:.1f} h on average; stated power of the "
        f"truth {stated:.3f}, decided {achieved:.3f}; repeating decides in {len(repeat)} cases"
        + (f", in {np.mean(repeat):.1f} h" if repeat else "")
    )


if __name__ == "__main__":
    main()
