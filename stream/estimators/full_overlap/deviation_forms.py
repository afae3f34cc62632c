"""The deviations computed from windows with full overlap, and their sums of squared differences."""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from stream.estimators.base import LEAST_SHARE
from stream.estimators.full_overlap.full_overlap_kernel import differences, modified
from stream.estimators.full_overlap.prefix_record import PrefixSums

_RESTART = 1 << 16


class Deviation(StrEnum):
    """The deviations by their usual abbreviations."""

    ALLAN = "adev"
    OVERLAPPING_ALLAN = "oadev"
    MODIFIED_ALLAN = "mdev"
    HADAMARD = "hdev"
    OVERLAPPING_HADAMARD = "ohdev"


class Form(NamedTuple):
    """What is summed: `weights` of adjacent means in a difference and the sum `norm` of their squares.

    One term spans `reach` averaging times; terms begin at every sample if `is_overlapped`, else once an averaging time.
    """

    weights: tuple[float, ...]
    norm: float
    reach: int
    is_overlapped: bool
    name: str
    chinese: str


FORMS = {
    Deviation.ALLAN: Form((-1.0, 1.0), 2.0, 2, False, "Allan deviation", "Allan 标准差"),
    Deviation.OVERLAPPING_ALLAN: Form((-1.0, 1.0), 2.0, 2, True, "Allan deviation", "Allan 标准差"),
    Deviation.MODIFIED_ALLAN: Form((-1.0, 1.0), 2.0, 3, True, "modified Allan deviation", "修正 Allan 标准差"),
    Deviation.HADAMARD: Form((1.0, -2.0, 1.0), 6.0, 3, False, "Hadamard deviation", "Hadamard 标准差"),
    Deviation.OVERLAPPING_HADAMARD: Form((1.0, -2.0, 1.0), 6.0, 3, True, "Hadamard deviation", "Hadamard 标准差"),
}


def squared_differences(record: PrefixSums, kind: Deviation, factor: int) -> tuple[float, int]:
    """Sum of squared differences times the factor, and their number n: the variance times ``norm * n * factor**2``."""
    if kind is Deviation.MODIFIED_ALLAN:
        squares, found = modified(record, factor, LEAST_SHARE, _RESTART)
        return squares / float(factor) ** 2, found
    form = FORMS[kind]
    stop = record.slots - len(form.weights) * factor + 1
    step = 1 if form.is_overlapped else factor
    _, squares, found = differences(record, factor, np.array(form.weights), LEAST_SHARE, 0, stop, step)
    return squares, found
