"""How surely functions of the set rate are named, with the lead of look-alikes and with that of any other effect.

    .venv/bin/python -m tests.bench.rate_look_alikes [--count 6]

Runs of rates only; each effect with an ideal significance of 10, 20 and 60.
"""

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.search import evidence
from tests.bench.loop_campaign import Campaign
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in

EFFECTS = ("scale_factor_asymmetry", "scale_factor_quadratic", "scale_factor_cubic", "saturation", "dead_zone")
SIZES = (10.0, 20.0, 60.0)
EXACT = evidence._EXACT_CHANNELS


def outcome(found: Diagnosis, name: str) -> str:
    """What a diagnosis says of the effect that was planted."""
    if not found.effects:
        return "none"
    single = [each.name for each in found.effects if not each.confounded]
    if any(each != name for each in single):
        return "wrong single name"
    if found.names == (name,) and single:
        return "right single name"
    every = {other for each in found.effects for other in (each.name, *(one.name for one in each.confounded))}
    return "set with it" if name in every else "set without it"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=6, help="seeds")
    given = parser.parse_args(arguments)
    total: dict[str, Counter[str]] = {"lead of any effect": Counter(), "lead of look-alikes": Counter()}
    for seed in range(given.count):
        campaign = Campaign(8000 + seed, types=("rate",), runs=5, duration_s=7200.0)
        for name in EFFECTS:
            for z in SIZES:
                planted = planted_in(campaign, name, z, np.random.default_rng((seed, 3)))
                runs = campaign.runs([planted], noise_seed=9000 + seed)
                for rule, channels in zip(total, (EXACT, frozenset[str]()), strict=True):
                    evidence._EXACT_CHANNELS = channels
                    total[rule][outcome(diagnose(runs, MODEL, declared_noise=DECLARED), name)] += 1
    for rule, counts in total.items():
        print(f"{rule}: {dict(counts)}")


if __name__ == "__main__":
    main()
