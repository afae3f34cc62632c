"""What is explainable of a residual: how often in noise, and in data with an effect that nobody declared.

    .venv/bin/python -m tests.bench.explainable [--count 10] [--row null] [--json]

Row ``null`` has nine noises that are not as declared, row ``outside`` effects that the library has no name for.
"""

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence

from analytics.loop.effects.base import Effect
from analytics.loop.explainable import explainable
from analytics.loop.residuals import residuals_of
from analytics.loop.tracing.diagnosis import diagnose
from tests.bench.tracing_cases import DECLARED, MODEL, built, cases


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10, help="seeds of each kind")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--row", choices=("null", "outside", "planted"), action="append")
    parser.add_argument("--declared-only", action="store_true", help="the residual of the declared model")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each case")
    given = parser.parse_args(arguments)
    for row in given.row or ("null", "outside"):
        significant: Counter[str] = Counter()
        tried: Counter[str] = Counter()
        for case in cases(row, given.count, first=given.first):
            made = built(case)
            effects: dict[str, Effect] | None = {} if given.declared_only else None
            found = diagnose(made.runs, MODEL, declared_noise=DECLARED, effects=effects)
            residuals = residuals_of(made.runs, found)
            if residuals is None:
                continue
            began = time.perf_counter()
            left = explainable(residuals)
            seconds = time.perf_counter() - began
            if left is None:
                continue
            tried[case.name] += 1
            significant[case.name] += left.is_significant
            line = {"case": case.key, "verdict": found.verdict.value, "effects": list(found.names), "s": seconds}
            print(json.dumps(line | left.document()) if given.json else f"{line} {left.document()}", flush=True)
        print(f"{row}: significant in {significant.total()} of {tried.total()}: {dict(significant)}", flush=True)


if __name__ == "__main__":
    main()
