"""Columns of many records that are made when they are asked for, and not kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from stream.batch import FloatArray


@dataclass(frozen=True)
class Recomputed(Sequence[FloatArray]):
    """An array for each record, made each time it is asked for: those of a fleet, kept for all fits, fill the memory.

    Parameters
    ----------
    make: Makes the array of a record, by its number.
    records: How many records there are.

    Examples
    --------
    >>> [each.size for each in Recomputed(np.ones, 3)]
    [0, 1, 2]
    """

    make: Callable[[int], FloatArray]
    records: int

    def __len__(self) -> int:
        return self.records

    @overload
    def __getitem__(self, number: int) -> FloatArray: ...

    @overload
    def __getitem__(self, number: slice) -> "Sequence[FloatArray]": ...

    def __getitem__(self, number: int | slice) -> "FloatArray | Sequence[FloatArray]":
        numbers = range(self.records)[number]  # raises IndexError
        return self.make(numbers) if isinstance(numbers, int) else [self.make(each) for each in numbers]


def joined(before: Sequence[FloatArray], more: Sequence[FloatArray]) -> Sequence[FloatArray]:
    """For each record, columns of both side by side; of several records they are made when they are asked for."""

    def of(number: int) -> FloatArray:
        return np.column_stack([before[number], more[number]])

    return (of(0),) if len(before) == 1 else Recomputed(of, len(before))
