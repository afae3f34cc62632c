"""A store for the tests of the server: two runs of a procedure, a spike, a gap, limits, and names that attack."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

START = "2026-11-21T18:00:00+08:00"
START_NS = 1_795_255_200 * 10**9
RATE_HZ = 100
STEP_S = 150
STEPS = 4
SPIKE_AT, SPIKE = 31_415, 50.0
GAP = (20_000, 24_000)  # rows that were not recorded
HOSTILE = ("<svg-onload=alert(1)>", "a..%2f..%2fetc", "O'Brien\";--", "{{7-7}}", "=cmd|'calc'!A0")
SPECIFICATION = """
revision = "A"

[[limit]]
metric = "bias"
lower = -5.0
upper = 5.0
unit_of_measure = "deg/h"
"""


def rates(unit: int, run: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Rate of a unit in a run, deg/s."""
    draws = np.random.default_rng([unit, run])
    found = draws.normal(unit / 3600.0, 0.002, RATE_HZ * STEP_S * STEPS)
    if (unit, run) == (1, 1):
        found[SPIKE_AT] = SPIKE
    return found


def make_store(folder: Path, run_command: Callable[..., Any]) -> Path:
    """Import the runs in one file, enter the limits."""
    tables = [_recorded(unit, run) for run in (1, 2) for unit in (1, 2, 3)]
    tables += [_table(name, name, np.arange(50) / 10.0, np.arange(50) % 3.0, np.zeros(50, int)) for name in HOSTILE]
    pq.write_table(pa.concat_tables(tables), folder / "all.parquet")
    (folder / "fog.toml").write_text(SPECIFICATION)
    for words in (
        ("import", "all.parquet", "--start", START),
        ("limits", "add", "fog.toml", "--reason", "first", "--by", "Li"),
        ("runs", "exclude", HOSTILE[3], "--reason", "<b>kicked</b>", "--by", "Li"),
    ):
        done = run_command(*words, "--store", "S", cwd=folder)
        assert done.code == 0, (words, done.out, done.err)
    return folder / "S"


def _recorded(unit: int, run: int) -> pa.Table:
    n = RATE_HZ * STEP_S * STEPS
    step = np.repeat(np.arange(STEPS), RATE_HZ * STEP_S)
    table = _table(f"FOG-000{unit}", f"run-{run}", np.arange(n) / RATE_HZ, rates(unit, run), step)
    if (unit, run) != (2, 1):
        return table
    kept = np.ones(n, bool)
    kept[slice(*GAP)] = False
    return table.filter(pa.array(kept))


def _table(unit: str, run: str, seconds: Any, rate: Any, step: Any) -> pa.Table:
    n = len(seconds)
    return pa.table(
        {
            "time[s]": seconds, "unit": [unit] * n, "run": [run] * n, "rate[deg/s]": rate,
            "temperature[degC]": 25.0 + seconds / 600, "procedure": ["static_bias"] * n, "repeat": step + 1,
            "position": ["IRA_east_west"] * n,
        }
    )  # fmt: skip
