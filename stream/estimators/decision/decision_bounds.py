"""Group-sequential bounds for the Allan deviation: how far from its limit an unfinished test must be to end.

``decision_bounds.txt`` holds the PASS and FAIL bounds of each error probability, looks down, T/tau across; it is made
and checked by ``tests/bench/decision_calibration.py``, with a walk of eight steps to a tau.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray
from stream.estimators.confidence import edf

LOOKS = 24
PROMISES = (0.01, 0.05)
AVERAGES = (8, 16, 32, 64, 128, 256, 512, 1024)
STRIDE_PER_TAU = 8
_TABLE = Path(__file__).with_suffix(".txt")


class Bounds(NamedTuple):
    """Bounds of (value/limit)**2 at looks 1 .. 24: at or below `passes` it is PASS, at or above `fails` FAIL."""

    passes: tuple[float, ...]
    fails: tuple[float, ...]


NO_BOUNDS = Bounds((0.0,) * LOOKS, (math.inf,) * LOOKS)


@lru_cache(maxsize=256)
def bounds(final_edf: float, error_probability: float) -> Bounds:
    """Bounds for a test whose finished variance has at least `final_edf` degrees of freedom, at one of `PROMISES`.

    The column b of the table with the next fewer degrees nu0 is scaled to nu degrees: above the limit b - 1,
    below it ln b, by sqrt(nu0/nu). Both are too wide rather than too narrow: by Wilson and Hilferty (1931) the quantile
    z of chi2/nu is 1 + z sqrt(2/nu) + (2/3)(z**2 - 1)/nu + ..., hence sqrt(nu)(b - 1) and -sqrt(nu) ln b fall with nu.
    That holds at early looks too, whose degrees, about proportional to T - 2 tau, grow faster with T than those of the
    end. Fewer degrees than those of the first column (T = 8 tau) have no bounds: nothing is decided before the end.

    >>> [round(side[11], 3) for side in bounds(400.0, 0.01)], bounds(2.0, 0.01) == NO_BOUNDS
    ([0.718, 1.342], True)
    """
    fitting = [i for i, column in enumerate(AVERAGES) if column_edf(column) <= final_edf]
    if not fitting:
        return NO_BOUNDS
    column = fitting[-1]
    shrink = math.sqrt(column_edf(AVERAGES[column]) / final_edf)
    passes, fails = _parsed()[error_probability]
    return Bounds(
        tuple(b**shrink for b in passes[:, column].tolist()),
        tuple(1.0 + (b - 1.0) * shrink for b in fails[:, column].tolist()),
    )


@lru_cache(maxsize=len(AVERAGES))
def column_edf(averages: int) -> float:
    """Degrees of freedom at the end of the test that a column of the table was calibrated on."""
    windows = (averages - 2) * STRIDE_PER_TAU + 1
    return edf(-2, 2, STRIDE_PER_TAU, windows, STRIDE_PER_TAU)


@lru_cache(maxsize=1)
def _parsed() -> dict[float, FloatArray]:
    numbers = np.array(_TABLE.read_text().split(), np.float64).reshape(len(PROMISES), 2, LOOKS, len(AVERAGES))
    return dict(zip(PROMISES, numbers, strict=True))
