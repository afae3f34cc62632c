"""Group-sequential bounds for the Allan deviation: how far from its limit an unfinished test must be to end.

``decision_bounds.txt`` was written by `table`, as ``tests/bench/early_decision.py --table`` prints it, and is checked
against `calibrated`.
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
RUNS = 200_000
SPENT_SHARE = 0.95
_SEED = 20261121
_STRIDE_PER_TAU = 8
_CHUNK = 1 << 19
_TABLE = Path(__file__).with_suffix(".txt")
_DIGITS = 1e4


class Bounds(NamedTuple):
    """Bounds of (value/limit)**2 at looks 1 .. 24: at or below `passes` it is PASS, at or above `fails` FAIL."""

    passes: tuple[float, ...]
    fails: tuple[float, ...]


NO_BOUNDS = Bounds((0.0,) * LOOKS, (math.inf,) * LOOKS)


@lru_cache(maxsize=256)
def bounds(final_edf: float, error_probability: float) -> Bounds:
    """Bounds for a test whose finished variance has at least `final_edf` degrees of freedom.

    Parameters
    ----------
    error_probability: One of `PROMISES`.

    Notes
    -----
    The column b of the table with the next fewer degrees nu0 is scaled to nu degrees: above the limit b - 1,
    below it ln b, by sqrt(nu0/nu). Both are too wide rather than too narrow: by Wilson and Hilferty (1931) the quantile
    z of chi2/nu is 1 + z sqrt(2/nu) + (2/3)(z**2 - 1)/nu + ..., hence sqrt(nu)(b - 1) and -sqrt(nu) ln b fall with nu.
    That holds at early looks too, whose degrees, about proportional to T - 2 tau, grow faster with T than those of the
    end. Fewer degrees than those of the first column (T = 8 tau) have no bounds: nothing is decided before the end.

    Examples
    --------
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
    windows = (averages - 2) * _STRIDE_PER_TAU + 1
    return edf(-2, 2, _STRIDE_PER_TAU, windows, _STRIDE_PER_TAU)


def simulated_ratios(averages: int, runs: int = RUNS) -> FloatArray:
    """Allan variance over its true value at the 24 looks, in simulated tests of random walk FM.

    Parameters
    ----------
    averages: T/tau.
    runs: Simulated tests; the first of them do not depend on how many follow.

    Notes
    -----
    Shape (runs, 24); NaN where a look comes before the first pair of averages.
    A walk of unit steps, eight to a tau. D is then 1/8 of a sum of steps with the weights 1, 2 .. 8 .. 2, 1, so that
    the true AVAR = E D**2 / 2 = (2 R**2 + 1)/(6 R), R = 8.
    Of the plausible noises random walk FM has the fewest degrees of freedom (`confidence.least_edf`), hence the widest
    scatter of the variance; bounds that hold for it are conservative for the others.
    """
    r = _STRIDE_PER_TAU
    samples = averages * r
    ends = np.arange(1, LOOKS + 1) * samples // LOOKS - 2 * r
    seen = ends >= 0
    rng = np.random.default_rng([_SEED, averages])
    ratios = np.full((runs, LOOKS), np.nan)
    chunk = max(1, _CHUNK // samples)
    for start in range(0, runs, chunk):
        part = ratios[start : start + chunk]
        walk = np.cumsum(rng.standard_normal((len(part), samples)), axis=1)
        integral = np.concatenate([np.zeros((len(part), 1)), np.cumsum(walk, axis=1)], axis=1)
        squares = np.square(integral[:, 2 * r :] - 2.0 * integral[:, r:-r] + integral[:, : -2 * r])
        part[:, seen] = np.cumsum(squares, axis=1)[:, ends[seen]] / (ends[seen] + 1.0)
    return ratios / (r * (2.0 * r**2 + 1.0) / 3.0)


def calibrated(ratios: FloatArray, error_probability: float) -> tuple[FloatArray, FloatArray]:
    """Bounds for PASS and for FAIL at each look that spend the error probability as the square of the time passed.

    Notes
    -----
    Four decimals; 0 and inf where nothing may be spent yet.
    At look k the most extreme of the undecided tests are decided, as many as bring the share of wrong ones up to
    0.95 alpha (k/24)**2 (alpha spending, Lan and DeMets 1983). The twentieth that is never spent allows for the
    scatter of the calibration, 2 % of alpha = 0.01 at 200,000 runs. The two sides are calibrated independently, which
    can only lower their errors.
    """
    both = []
    for outward in (-1.0, 1.0):
        alive = np.ones(len(ratios), np.bool_)
        side = np.full(LOOKS, math.inf if outward > 0.0 else 0.0)
        for look in range(LOOKS):
            allowed = SPENT_SHARE * error_probability * ((look + 1) / LOOKS) ** 2 * len(ratios)
            more = int(allowed) - int(np.count_nonzero(~alive))
            extreme = np.sort(outward * ratios[alive, look])
            if more <= 0 or np.isnan(extreme[-1]):
                continue
            side[look] = outward * math.ceil(extreme[-more] * _DIGITS) / _DIGITS + 0.0  # no minus zero
            alive &= outward * ratios[:, look] < outward * side[look]
        both.append(side)
    return both[0], both[1]


def table() -> str:
    """The table, rebuilt: PASS and FAIL bounds of each error probability, looks down, T/tau across; 2 minutes."""
    columns = [simulated_ratios(averages) for averages in AVERAGES]
    lines = []
    for promise in PROMISES:
        for side in (0, 1):
            block = np.column_stack([calibrated(ratios, promise)[side] for ratios in columns])
            lines += [" ".join(f"{bound:8.4f}" for bound in row) for row in block.tolist()]
    return "\n".join(lines)


@lru_cache(maxsize=1)
def _parsed() -> dict[float, FloatArray]:
    numbers = np.array(_TABLE.read_text().split(), np.float64).reshape(len(PROMISES), 2, LOOKS, len(AVERAGES))
    return dict(zip(PROMISES, numbers, strict=True))
