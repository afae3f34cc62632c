"""A store of several units in runs that they share with instruments; enough for metrics, verdicts and diagnoses."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from analytics.cluster.engine import Engine
from analytics.cluster.metric_tasks import ClusterComputation
from analytics.evaluation.kept_metrics import unit_metrics
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.events import CheckEntered, Verdict
from tests.analytics.cluster.sequential import nobody
from tests.analytics.conftest import SECOND_NS, START_NS

UNITS = ("FOG-1", "O'Brien, 2", "零偏-3")
# of entered checks, of several units at one supply, over several runs, from samples
SOME = ("visual_check", "power", "bias_repeatability", "bias_stability_averaged")
HOUR_NS = 3600 * SECOND_NS
SPECIFICATION = """
[product."FOG-70"]
average_s = 10.0
[[limit]]
metric = "bias"
upper = 10.5
unit_of_measure = "deg/h"
"""


def fill(tested: Any, runs: int = 3, units: tuple[str, ...] = UNITS, seconds: int = 600) -> None:
    """Runs in which units stand still in a chamber and are fed by one supply; a unit that was only looked at."""
    rng = np.random.default_rng(7)
    for number in range(runs):
        run, t_ns = f"r{number}", START_NS + number * 24 * HOUR_NS
        tested.run(run, t_ns=t_ns, procedure="static_bias")
        warm = 25.0 + 10.0 * np.sin(np.arange(seconds) / 150.0 + number)
        tested.samples(run, "chamber", "chamber_temperature", warm, t0_ns=t_ns, dt_ns=SECOND_NS, unit_of_measure="degC")
        for signal, measure, size in (("supply_voltage", "V", 5.0), ("supply_current", "A", 0.1)):
            tested.samples(
                run, "PSU-1", signal, rng.normal(size, 0.01, seconds), t0_ns=t_ns, dt_ns=SECOND_NS,
                unit_of_measure=measure,
            )  # fmt: skip
        for place, unit in enumerate(units):
            tested.mount(run, unit, t_ns=t_ns, product="FOG-70", lot="L1")
            tested.power_on(run, unit, t_ns)
            rate = 10.0 + place + rng.normal(0, 1.0, 10 * seconds) + np.repeat(0.02 * warm, 10)
            signals = {"rate": (rate, "deg/h"), "temperature": (warm + rng.normal(0, 0.01, seconds), "degC")}
            words = {"procedure": "power_consumption"} if number == 0 else {"position": "IRA_up"}
            tested.step(run, unit, signals, t0_ns=t_ns, dt_ns=SECOND_NS // 10, **words)
    tested.product(SPECIFICATION)
    tested.document(
        CheckEntered(run="", t_ns=START_NS, unit="FOG-9", item="visual", verdict=Verdict.PASS, by="Li", uid="ab" * 8)
    )


def computed(
    store: Store, kept: Path, engine: Engine | None = None, wanted: Collection[str] = ()
) -> tuple[pa.Table, pa.Table]:
    """Step records and metrics, with what is kept in a folder."""
    computation = None if engine is None else ClusterComputation(engine, nobody)
    with Catalog(store, kept=kept) as catalog, catalog.suspended_layers():
        unit_metrics(catalog, None, wanted, computation)
        return catalog.stored("step_means"), catalog.stored("unit_metrics")
