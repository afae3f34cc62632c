"""The one run without which an effect of the biases of runs does not show."""

import numpy as np

from analytics.loop.tracing.held_out.held_out_set import HeldOutSet
from analytics.loop.tracing.held_out.run_walk import of_runs, seen_within_runs
from analytics.loop.tracing.search.effect_search import Search
from analytics.methods.distributions import student_quantile
from stream.batch import FloatArray

FEWEST_RUNS = 5  # of fewer, none can be spared
_QUANTILE = 0.975


def sole_runs(box: HeldOutSet, found: Search, over_all: float | None = None) -> dict[str, str]:
    """Effects that the biases of all runs show, but not without one of them, and that run.

    One far run may differ for any reason. Held-out runs do not answer for it: with the far run in the fit, the bias of
    all others is right with the effect and wrong without it.

    Parameters
    ----------
    box, found: All blocks of a unit with the predictions of the search.
    over_all: Coefficient over all runs of the only effect, if their biases gave it; that of the training may be any.
    """
    runs = box.record.stack.runs
    sole = {}
    for number, each in enumerate(found.common):
        trained = float(found.common_fit(each)[0][0])
        size = 1.0 if over_all is None or trained == 0.0 else over_all / trained
        if len(runs) < FEWEST_RUNS or seen_within_runs([box], found, number, size):
            continue
        bias, effect, _ = of_runs(box, number)
        if (which := sole_bearer(bias, effect)) is not None:
            sole[each.name] = runs[which].run
    return sole


def sole_bearer(bias: FloatArray, effect: FloatArray) -> int | None:
    """Which of the biases alone shows that they follow an effect, at 5 % by Student's t; None if others do, or none do.

    The scatter is that about the line through all of them, which does not count a far bias as scatter.

    >>> bias = np.array([0.1, -0.1, 0.0, 0.1, -0.1, 3.0])
    >>> sole_bearer(bias, np.array([1.0, 1.1, 0.9, 1.0, 1.1, 10.0]))
    5
    >>> sole_bearer(np.arange(6.0) + bias / 3, np.arange(6.0)) is None
    True
    """
    degrees = bias.size - 2
    centred = effect - effect.mean()
    strength = float(centred @ centred)
    if degrees < 2 or strength <= 1e-18 * max(1.0, float(effect @ effect)):
        return None
    slope = float(centred @ bias) / strength
    left = bias - bias.mean() - slope * centred
    scatter = float(np.sqrt(left @ left / degrees))
    least = float(student_quantile(_QUANTILE, degrees)) * scatter
    if abs(slope) * np.sqrt(strength) < least:
        return None
    without = []
    for at in range(bias.size):
        column, value = np.delete(effect, at), np.delete(bias, at)
        column = column - column.mean()
        size = float(np.linalg.norm(column))
        without.append(np.sign(slope) * float(column @ value) / size if size > 0 else 0.0)
    which = int(np.argmin(without))
    return which if without[which] < least else None
