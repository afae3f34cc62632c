"""Correlation of the components of a budget: coefficients, fully correlated groups, independent sets."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analytics.uncertainty.component import Component
from stream.batch import FloatArray
from stream.errors import BadInput

_NEGATIVE = -1e-9  # eigenvalues of a correlation matrix below this are no rounding


class Correlation(NamedTuple):
    """Correlation coefficient r of two components, by their English names."""

    first: str
    second: str
    coefficient: float


def correlation_matrix(components: Sequence[Component], correlations: Sequence[Correlation]) -> FloatArray:
    """Correlation coefficients of the components; 1 within a group.

    Raises BadInput for unknown names, a coefficient beyond -1 .. 1, and coefficients that contradict each other.
    """
    places = {component.en: place for place, component in enumerate(components)}
    if len(places) < len(components):
        twice = sorted({c.en for c in components if sum(c.en == other.en for other in components) > 1})
        raise BadInput(f"components have names of their own; {', '.join(twice)} occurs twice")
    matrix = np.eye(len(components))
    for first in components:
        for second in components:
            if first.group and first.group == second.group:
                matrix[places[first.en], places[second.en]] = 1.0
    for first_name, second_name, coefficient in correlations:
        for name in (first_name, second_name):
            if name not in places:
                raise BadInput(f"correlation of {name!r}: the budget has the components {', '.join(places)}")
        if not -1 <= coefficient <= 1:
            raise BadInput(f"correlation of {first_name!r} and {second_name!r}: {coefficient:g} is not within -1 .. 1")
        one, other = places[first_name], places[second_name]
        if one == other:
            raise BadInput(f"correlation of {first_name!r} with itself is 1; name two components")
        matrix[one, other] = matrix[other, one] = coefficient
    if len(components) and np.linalg.eigvalsh(matrix)[0] < _NEGATIVE:
        raise BadInput("the correlation coefficients contradict each other: no quantities are correlated like that")
    return matrix


def independent_sets(matrix: FloatArray) -> list[list[int]]:
    """Places of the components in sets that are independent of each other.

    >>> independent_sets(np.array([[1, 0, 0.5], [0, 1, 0], [0.5, 0, 1]]))
    [[0, 2], [1]]
    """
    found: list[list[int]] = []
    left = set(range(len(matrix)))
    while left:
        reached, fresh = set[int](), {min(left)}
        while fresh:
            reached |= fresh
            fresh = {int(other) for place in fresh for other in np.flatnonzero(matrix[place])} - reached
        found.append(sorted(reached))
        left -= reached
    return found
