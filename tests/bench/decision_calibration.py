"""Calibration of the group-sequential bounds of early decisions (`stream.estimators.decision.decision_bounds`).

python -m tests.bench.early_decision --table
"""

import math

import numpy as np

from stream.batch import FloatArray
from stream.estimators.decision.decision_bounds import AVERAGES, LOOKS, PROMISES, STRIDE_PER_TAU

RUNS = 200_000
SPENT_SHARE = 0.95
_SEED = 20261121
_CHUNK = 1 << 19
_DIGITS = 1e4


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
    r = STRIDE_PER_TAU
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
