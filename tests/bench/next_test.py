"""Does the recommended test decide? Confounded campaigns, the test that is recommended, and the diagnosis after it.

    .venv/bin/python -m tests.bench.next_test [--count 6] [--first 0] [--json]

Each case plants one effect in a design that leaves it confounded. The plan with the least hours that states a power of
90 % or more is simulated with the truth at work, by the physics of `loop_drives`, and added to the training runs. It
counts as decided if the diagnosis then has the truth as its only name. Stated power is that of the truth.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.next_test.plans import TestPlan
from analytics.loop.next_test.recommendation import next_test
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.next_test.timeline import Timeline, timeline
from analytics.loop.tracing.diagnosis import diagnose
from tests.bench.loop_campaign import Campaign, Planted
from tests.bench.loop_drives import SENSOR_NOISE, Drive, physics_of
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in

DESIGNS: dict[str, tuple[tuple[str, ...], int, tuple[str, ...]]] = {
    "ramp": (
        ("ramp",), 9,
        ("temperature_squared", "thermal_lag", "drift_in_run", "temperature_cubed", "thermal_hysteresis"),
    ),
}  # fmt: skip
Z = 14.0


def planned_runs(
    campaign: Campaign, plan: TestPlan, planted: Planted, bounds: StationBounds, seed: int
) -> list[RunBlocks]:
    """The runs of a plan with an effect at work."""
    played = timeline(plan.test, bounds)
    done = Campaign(seed, runs=plan.test.repeats, types=("static",), duration_s=_whole(played) * campaign.block_s)
    last = max(each.day for each in campaign.drives)
    for number in range(plan.test.repeats):
        rng = np.random.default_rng((seed, 5, number))
        done.drives[number] = _driven(played, done.drives[number].time_s, last + 1.0 + number, rng)
        done.names[number] = f"next-{number + 1}"
        powered = np.interp(done.drives[number].time_s, played.time_s, played.is_powered.astype(float)) > 0.99
        whole = powered.reshape(-1, round(campaign.block_s / campaign.step_s)).all(axis=1)
        done.slots[number] = np.flatnonzero(whole)
    return done.runs([planted])


def _whole(played: Timeline) -> int:
    return int(played.time_s[-1] // 30.0)


def _driven(played: Timeline, time_s: Any, day: float, rng: np.random.Generator) -> Drive:
    asked = {"table_rate": np.interp(time_s, played.time_s, played.rate_deg_per_s)}
    if np.isfinite(played.setpoint_deg_c).any():
        known = np.isfinite(played.setpoint_deg_c)
        asked["setpoint"] = np.interp(time_s, played.time_s[known], played.setpoint_deg_c[known])
    since = np.interp(time_s, played.time_s, np.nan_to_num(played.since_power_on_s))
    true = physics_of(time_s, asked, since, rng) | {"day": day + time_s / 86400.0}
    read = {
        name: values + SENSOR_NOISE.get(name, 0.0) * rng.standard_normal(time_s.size) for name, values in true.items()
    }
    return Drive("next", time_s, day, true, read)


def tried(design: str, name: str, number: int) -> dict[str, Any] | None:
    """One case; None if its design does not leave it confounded."""
    types, runs, _ = DESIGNS[design]
    campaign = Campaign(4000 + number, types=types, runs=runs)
    planted = planted_in(campaign, name, Z, np.random.default_rng((number, 3)))
    before = campaign.runs([planted], noise_seed=7000 + number)
    found = diagnose(before, MODEL, declared_noise=DECLARED)
    bounds = StationBounds.of_runs(before)
    asked = next_test(found, before, MODEL, declared_noise=DECLARED, bounds=bounds)
    if asked is None or asked.question != "which" or name not in asked.rivals:
        return None
    line: dict[str, Any] = {"design": design, "effect": name, "seed": number, "rivals": list(asked.rivals)}
    plan = next((each for each in asked.plans if not each.test.like), None)
    if plan is None:
        return line | {"plan": None, "inseparable": bool(asked.why_not)}
    added = planned_runs(campaign, plan, planted, bounds, 9000 + number)
    after = diagnose([*before, *added], MODEL, declared_noise=DECLARED, holdout=asked.holdout)
    single = [each for each in after.effects if not each.confounded]
    return line | {
        "plan": plan.test.name,
        "runs": plan.test.repeats,
        "hours": plan.hours,
        "stated": plan.power,
        "stated_of_truth": plan.by_truth[name],
        "repeat_hours": None if asked.repeat is None else asked.repeat.hours,
        "verdict": after.verdict.value,
        "decided": [each.name for each in after.effects] == [name] and len(single) == 1,
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
            for name in DESIGNS[design][2]:
                line = tried(design, name, number)
                if line is not None:
                    lines.append(line)
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
