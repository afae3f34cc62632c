"""Units of a few plain runs: white noise, a channel or two, and one planted error."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from stream.batch import FloatArray

SECONDS = 2400
TIME_S = np.arange(float(SECONDS))
Columns = Mapping[str, FloatArray]


def noise(rng: np.random.Generator, spread: float = 0.01) -> FloatArray:
    """A bias of the run's own and white noise of 0.01 deg/sqrt(h)."""
    return np.asarray(spread * rng.standard_normal() + 0.6 * rng.standard_normal(SECONDS))


def steps(levels: Sequence[float], rng: np.random.Generator) -> FloatArray:
    """The levels in any order, each for the same time."""
    return np.repeat(rng.permutation(np.array(levels, np.float64)), SECONDS // len(levels))


def warming(number: int) -> FloatArray:
    """A temperature that goes up and down, in each run with another period."""
    return np.asarray(25.0 + 20.0 * np.sin(TIME_S / (150.0 + 20.0 * number)))


def stored(folder: Path, run_command: Callable[..., Any], units: Mapping[str, Mapping[str, Columns]]) -> Path:
    """A store with the runs of units, by the names of their files' columns."""
    for unit, runs in units.items():
        for run, columns in runs.items():
            frame = {"time[s]": TIME_S, "unit": [unit] * SECONDS, "run": [run] * SECONDS, **columns}
            pl.DataFrame(frame).write_parquet(folder / f"{unit}-{run}.parquet")
    files = sorted(folder.glob("*.parquet"))
    assert run_command("import", *files, "--store", folder / "store", cwd=folder).code == 0
    return folder / "store"
