"""What the channels of a set of runs cannot tell: constant ones, and copies of others."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from analytics.loop.tracing.record import Record
from stream.batch import FloatArray

COPY = 1 - 1e-9
"""Correlation above which a channel is a copy of another, perhaps in another unit."""
ONE_FROM_THE_OTHER = frozenset({frozenset({"input_rate", "table_rate"}), frozenset({"day", "time_since_power_on"})})
"""Pairs of which one is taken from the other where it is not recorded; the reduction says so."""


def channel_limits(record: Record) -> tuple[str, ...]:
    """Return what the reader has to know of the channels.

    Parameters
    ----------
    record: The blocks.
    """
    names = sorted(set.intersection(*(set(run.channels) for run in record.stack.runs)))
    values = {name: record.stack.column(lambda run, name=name: run.mean(name)) for name in names}  # type: ignore[misc]
    moving = {name: each for name, each in values.items() if np.isfinite(each).all() and np.ptp(each) > 0}
    constant = sorted(name for name, each in values.items() if np.isfinite(each).all() and np.ptp(each) == 0)
    limits = [f"channel {name} is constant: its effects cannot be looked for" for name in constant]
    limits += [
        f"channels {first} and {second} are copies of each other: their effects cannot be told apart"
        for first, second in _copies(moving)
    ]
    return tuple(limits)


def blind_terms(record: Record, labels: Sequence[str]) -> tuple[str, ...]:
    """Terms of the declared model that these runs do not tell from the terms before them."""
    blind = []
    basis = np.empty((len(record), 0))
    for label, column in zip(labels, record.design.T, strict=True):
        length = float(np.linalg.norm(column))
        rest = column - basis @ (basis.T @ column)
        if length == 0 or np.linalg.norm(rest) < 1e-6 * length:
            blind.append(label)
        else:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return tuple(blind)


def _copies(values: dict[str, FloatArray]) -> list[tuple[str, str]]:
    if len(values) < 2:
        return []
    correlation = np.abs(np.corrcoef(np.array(list(values.values()))))
    return [
        (first, second)
        for (i, first), (j, second) in combinations(enumerate(values), 2)
        if correlation[i, j] > COPY and frozenset({first, second}) not in ONE_FROM_THE_OTHER
    ]
