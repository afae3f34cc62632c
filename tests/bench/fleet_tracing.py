"""Effects too small for one unit, pooled over a fleet: how often found, and which units lack them.

    .venv/bin/python -m tests.bench.fleet_tracing [--count 10] [--z 2] [--units 8] [--without 0]

Each case plants one effect of significance `z` in all units of a fleet but the last `without`, and diagnoses it pooled.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analytics.loop.tracing.fleet import diagnose_fleet
from tests.bench.loop_campaign import Campaign
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in

EFFECTS = (
    "gravity_o",
    "temperature_squared",
    "magnetic_i",
    "supply_voltage_squared",
    "scale_factor_cubic",
    "vibration",
)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10, help="cases")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--units", type=int, default=8)
    parser.add_argument("--without", type=int, default=0, help="units without the effect")
    parser.add_argument("--z", type=float, default=2.0, help="significance in one unit")
    given = parser.parse_args(arguments)
    right = named = wrong = told = 0
    for number in range(given.first, given.first + given.count):
        name = EFFECTS[number % len(EFFECTS)]
        campaign = Campaign(6000 + number)
        planted = planted_in(campaign, name, given.z, np.random.default_rng((number, 3)))
        units = {}
        for unit in range(given.units):
            own = [planted] if unit < given.units - given.without else []
            runs = campaign.runs(own, noise_seed=100 * number + unit)
            units[f"U{unit}"] = [replace(run, unit=f"U{unit}") for run in runs]
        found = diagnose_fleet(units, MODEL, declared_noise=dict.fromkeys(units, DECLARED))
        names = [each.name for each in found.effects]
        sets = {name for each in found.effects for name in (each.name, *(other.name for other in each.confounded))}
        right += name in sets
        named += names == [name]
        wrong += bool(names) and name not in sets
        rows = next(iter(found.by_unit.values()), ())  # of the effect found, or one that the data cannot separate
        absent = [each.unit for each in rows if each.presence < 0.05]
        told += sum(each in {f"U{unit}" for unit in range(given.units - given.without, given.units)} for each in absent)
        over = found.over_units.get(name)
        line = {"effect": name, "seed": number, "found": names, "absent": absent, "spread": over and over.spread}
        print(json.dumps(line), flush=True)
    print(
        f"z = {given.z:g} in {given.units - given.without} of {given.units} units: found in {right} of {given.count}, "
        f"as the only name in {named}, wrong name in {wrong}; units without it named {told} of "
        f"{given.count * given.without}"
    )


if __name__ == "__main__":
    main()
