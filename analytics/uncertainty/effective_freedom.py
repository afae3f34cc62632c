"""Effective degrees of freedom of a combined standard uncertainty (Welch-Satterthwaite, JCGM 100 G.4)."""

import math
from collections.abc import Sequence

import numpy as np

from analytics.uncertainty.component import Component
from analytics.uncertainty.correlation import independent_sets
from stream.batch import FloatArray


def effective_freedom(components: Sequence[Component], matrix: FloatArray) -> float:
    """Effective degrees of freedom v = u^4 / sum(u_s^4 / v_s), infinite where every component's are.

    The formula wants independent terms: each set s of components that are correlated with each other is one term, with
    its combined u_s and the least degrees of freedom in it. That is exact where they come from the same observations
    (Willink 2007, doi:10.1088/0026-1394/44/5/010) and cautious elsewhere.

    >>> from analytics.uncertainty.component import Component
    >>> two = [Component.type_a(name, "", 1.0, freedom=4, unit="1") for name in ("a", "b")]
    >>> effective_freedom(two, np.eye(2)), effective_freedom(two, np.ones((2, 2)))
    (8.0, 4.0)
    """
    signed = np.array([component.signed for component in components], dtype=np.float64)
    total = combined_variance(signed, matrix)
    if total == 0:
        return math.inf
    lost = 0.0
    for places in independent_sets(matrix):
        least = min(components[place].freedom for place in places)
        share = combined_variance(signed[places], matrix[np.ix_(places, places)]) / total
        lost += share**2 / least
    return 1 / lost if lost > 0 else math.inf


def combined_variance(signed: FloatArray, matrix: FloatArray) -> float:
    """Variance of the sum of correlated contributions (JCGM 100 (16))."""
    return max(0.0, float(signed @ matrix @ signed))
