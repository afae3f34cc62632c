"""How often the 95 % bounds of the metrics hold the truth: ``python -m tests.bench.metric_coverage [--units 500]``.

Units are simulated in the tests of the standards, each step by its samples; their records go through the metrics as
they are. Coverage is to lie within 93 to 98 %; limits that are made to hold for several differences together, or where
a value is near 0, are conservative: for them only the 93 % is asked. A metric is marked OUTSIDE where the one-sided
99.9 % binomial bound, corrected for the number of checks made together, excludes that; the command fails then.

With ``--flicker`` the noise of a run drifts through its steps and the pauses between them.

Not among them are metrics whose limits are tested inputs (range, threshold, resolution), polarity, entered checks, and
those of samples (start-up, power, bandwidth), which have tests of their own; the coefficients of the Allan curve are in
``coefficients.py``.
"""

import argparse
import json
import math
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from scipy import stats

from storage.store import Store
from tests.bench.metric_steps import AXES, NOISE, Unit, metrics_of, records_of

LEAST, MOST = 0.93, 0.98
STATIC = 3600  # samples of a static step, 1 s apart
Reported = Mapping[str, Any]


class Check(NamedTuple):
    """A metric's rows that are compared with one truth.

    Parameters
    ----------
    metric : str
        Which.
    truth : callable
        Of the unit and the parameters of a row.
    conservative : bool
        Whether only the lower bound is asked.
    where : mapping
        Parameters that the rows have; `standard` is the row's own column.
    procedure : str
        Of the runs.
    """

    metric: str
    truth: Callable[[Unit, Reported], float]
    conservative: bool = False
    where: Mapping[str, Any] = {}
    procedure: str = "static_bias"


def scatter_of_bias(kind: str) -> Callable[[Unit, Reported], float]:
    """Of power-ons, two a day; the noise of a mean is taken off."""

    def truth(unit: Unit, _: Reported) -> float:
        within = unit.turn_on**2
        return math.sqrt(
            {"run_to_run": within, "day_to_day": unit.from_day_to_day**2 + within / 2}.get(
                kind, unit.from_day_to_day**2
            )
        )

    return truth


def of_axis(values: Sequence[float]) -> Callable[[Unit, Reported], float]:
    largest = max(values, key=abs)
    return lambda _, row: abs(largest if row["axis"] == "largest" else values[AXES.index(row["axis"])])


USUAL = Unit("")
BIAS_G, BIAS_CHANGE = USUAL.bias_per_g, USUAL.bias_change
SCALE_CHANGE = tuple(each * 1e-6 for each in USUAL.scale_change_ppm)
MISALIGNMENT = math.hypot(*USUAL.misalignment_arcmin)
SCALE = "scale_factor"

CHECKS = [
    Check("bias_stability", lambda *_: NOISE),
    *(
        Check(
            "bias_stability_averaged",
            lambda _, reported: NOISE / math.sqrt(reported["average_s"]),
            where={"average_s": average_s},
        )
        for average_s in (1.0, 10.0, 100.0)
    ),
    Check("angle_random_walk", lambda *_: NOISE / 60),
    *(
        Check("bias_repeatability", scatter_of_bias(kind), kind == "between_day_component", {"kind": kind, "run": None})
        for kind in ("run_to_run", "day_to_day", "between_day_component")
    ),
    # records of a minute on one day, whose noise is half of the scatter
    *(
        Check("bias_repeatability", lambda unit, _: unit.turn_on, True, {"kind": kind}, "bias_repeatability")
        for kind in ("all", "within_day_component")
    ),
    Check("bias_temperature_sensitivity", lambda unit, _: unit.bias_per_degree, True,
          procedure="bias_temperature_sensitivity"),
    *(
        Check(f"bias_{name}", of_axis(values), axis == "largest", {"axis": axis}, f"bias_{procedure}")
        for name, values, procedure in (
            ("acceleration_sensitivity", BIAS_G, "acceleration_sensitivity"),
            ("shock_change", BIAS_CHANGE, "shock"),
            ("vibration_change", BIAS_CHANGE, "vibration"),
        )
        # without a latitude the largest of an acceleration sensitivity has the Earth's rate in it, and no interval
        for axis in ("X", "largest")[: 1 if procedure == "acceleration_sensitivity" else 2]
    ),
    *(
        Check(SCALE, lambda unit, _: 1 + unit.scale_ppm * 1e-6, False, {"standard": standard}, SCALE)
        for standard in ("GJB2426A", "JJF2014")
    ),
    # conservative: a drift that is too small to be seen is allowed for
    Check("fitted_zero", lambda *_: 0.0, True, {"standard": "GJB2426A"}, SCALE),
    Check("fitted_zero", lambda unit, _: unit.bias / (1 + unit.scale_ppm * 1e-6), True, {"standard": "JJF2014"},
          SCALE),
    Check("scale_factor_nonlinearity", lambda *_: 0.0, True, {"standard": "GJB2426A"}, SCALE),
    Check("scale_factor_asymmetry", lambda *_: 0.0, True, {"standard": "GJB2426A"}, SCALE),
    Check("scale_factor_temperature_sensitivity",
          lambda unit, _: unit.scale_ppm_per_degree / (1 + unit.scale_ppm * 1e-6),
          True, {"standard": "GJB2426A"}, "scale_factor_temperature_sensitivity"),
    Check("scale_factor_acceleration_sensitivity", lambda unit, _: unit.scale_ppm_per_g * 1e-6, False, {},
          "scale_factor_acceleration_sensitivity"),
    *(
        Check("scale_factor_shock_change", of_axis(SCALE_CHANGE), axis == "largest", {"axis": axis},
              "scale_factor_shock")
        for axis in ("X", "largest")
    ),
    Check("scale_factor_repeatability", lambda unit, _: unit.scale_scatter_ppm / (1 + unit.scale_ppm * 1e-6), False,
          {"kind": "all", "standard": "GJB2426A"}, "scale_factor_repeatability"),
    # noise of a misalignment beside its scatter is 0.001 arcmin
    Check("misalignment_repeatability", lambda unit, _: unit.misalignment_scatter_arcmin, False, {},
          "misalignment_repeatability"),
]  # fmt: skip

OF_WHITE_NOISE = ("bias_stability", "bias_stability_averaged", "bias_repeatability")


class Covered(NamedTuple):
    """A row of the table."""

    metric: str
    of: str
    rows: int
    held: int
    conservative: bool
    outside: bool


def covered(
    store: Store, units: int, seed: int, checks: Sequence[Check] = tuple(CHECKS), flicker: float = 0.0
) -> Iterator[Covered]:
    """Coverage of the metrics over so many simulated units, test by test.

    A unit's first row of a kind is counted, so that all that are counted are independent.
    """
    every = [Unit(f"U{number:04d}") for number in range(units)]
    by_procedure: defaultdict[str, list[Check]] = defaultdict(list)
    for check in checks:
        by_procedure[check.procedure].append(check)
    for number, (procedure, asked) in enumerate(by_procedure.items()):
        records = records_of(every, np.random.default_rng([seed, number]), [procedure], flicker=flicker)
        names = dict.fromkeys(check.metric for check in asked)
        rows = _rows(metrics_of(store, records, names))
        yield from (_covered(check, rows, every, len(checks)) for check in asked)


def _rows(table: pa.Table) -> list[dict[str, Any]]:
    return [json.loads(row["parameters"] or "{}") | row for row in table.to_pylist() if row["value"] is not None]


def _covered(check: Check, rows: Sequence[dict[str, Any]], units: Sequence[Unit], checks: int) -> Covered:
    by_name = {unit.name: unit for unit in units}
    first: dict[str, dict[str, Any]] = {}
    for row in sorted(rows, key=lambda each: str(each["run"])):
        is_asked = row["metric"] == check.metric and all(row.get(name) == value for name, value in check.where.items())
        if is_asked and row["lo"] is not None and row["hi"] is not None:
            first.setdefault(row["unit"], row)
    held = sum(each["lo"] <= check.truth(by_name[name], each) <= each["hi"] for name, each in first.items())
    of = " ".join(str(value) for value in check.where.values())
    return Covered(check.metric, of, len(first), held, check.conservative, _is_outside(check, held, len(first), checks))


def _is_outside(check: Check, held: int, rows: int, checks: int) -> bool:
    """Whether the binomial bounds exclude what is asked; two-sided checks are two."""
    tail = 0.001 / (2 * checks)
    if rows == 0:
        return True
    too_few = stats.binom.cdf(held, rows, LEAST) < tail
    too_many = not check.conservative and stats.binom.sf(held - 1, rows, MOST) < tail
    return bool(too_few or too_many)


def line_of(row: Covered) -> str:
    asked = ">= 93 %" if row.conservative else "93 to 98 %"
    share = f"{100 * row.held / row.rows:6.1f} %" if row.rows else "     no rows"
    return f"{row.metric:40} {row.of:26} {share} of {row.rows:4}, {asked}{'  OUTSIDE' if row.outside else ''}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--procedure", help="only the tests of this one")
    parser.add_argument("--flicker", type=float, default=0.0, help="bias instability of the units, deg/h")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    is_outside = False
    with tempfile.TemporaryDirectory(prefix="gyrofleet-coverage-") as folder:
        store = Store.create(Path(folder) / "store")
        # the truth of a scatter of samples is not defined where it grows with the record
        checks = [
            each
            for each in CHECKS
            if options.procedure in {None, each.procedure} and not (options.flicker and each.metric in OF_WHITE_NOISE)
        ]
        for row in covered(store, options.units, options.seed, checks, options.flicker):
            print(json.dumps(row._asdict()) if options.json else line_of(row), flush=True)
            is_outside |= row.outside
    sys.exit(is_outside)


if __name__ == "__main__":
    main()
