"""RMS that noise alone leaves in averages of blocks."""

import itertools
from dataclasses import dataclass

import numpy as np

from analytics.tracing.record import Record
from analytics.tracing.result import NoiseCoefficients
from stream.batch import FloatArray, IntArray

LEAST_FILLED = 0.5
"""An average counts if at least this part of its blocks is there."""


@dataclass(frozen=True)
class Averages:
    """Which blocks make up each average; the rows of each follow one another.

    Parameters
    ----------
    rows : tuple of array of int
        Blocks of each average.
    """

    rows: tuple[IntArray, ...]

    def of(self, values: FloatArray) -> FloatArray:
        """Mean of values, or of rows of columns, over each average."""
        sums = np.cumsum(values, axis=0)
        first = np.array([rows[0] for rows in self.rows])
        last = np.array([rows[-1] for rows in self.rows])
        size = (last + 1 - first).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((sums[last] - sums[first] + values[first]) / size)


def averages_of(record: Record, blocks: int, within: IntArray) -> Averages:
    """Averages of so many neighbouring blocks; none reaches over two runs.

    Parameters
    ----------
    record : Record
        The blocks.
    blocks : int
        Length of an average.
    within : array of int
        Rows that may take part.
    """
    number = record.stack.run_number[within]
    slot = record.stack.slot[within]
    found = []
    for run in np.unique(number):
        rows, own = within[number == run], slot[number == run]
        window = (own - own[0]) // blocks
        edges = np.flatnonzero(np.diff(window, prepend=-1, append=-1))
        pairs = itertools.pairwise(edges)
        found += [rows[first:end] for first, end in pairs if end - first >= LEAST_FILLED * blocks]
    return Averages(tuple(found))


def expected_variance(record: Record, noise: NoiseCoefficients, averages: Averages) -> FloatArray:
    """Variance of each average that the noise model expects, turn-on scatter included."""
    space = record.noise_model.space(noise)
    slot = record.stack.slot
    number = record.stack.run_number
    starts = slot[np.flatnonzero(record.steps == 0)]
    correlated: dict[bytes, float] = {}
    variances = []
    for rows in averages.rows:
        own = slot[rows] - slot[rows[0]]
        key = own.tobytes()
        if key not in correlated:
            apart = np.abs(own[:, None] - own[None, :])
            parts = [v * float(np.mean(d**apart)) for d, v in zip(space.decay, space.variance, strict=True)]
            correlated[key] = sum(parts)
        walked = slot[rows] - starts[number[rows[0]]]
        # mean of min(i, j) over all pairs of increasing numbers
        both = float(np.sum(walked * (2 * np.arange(rows.size, 0, -1) - 1))) / rows.size**2
        white = space.white * float(record.white[rows].mean()) / rows.size
        variances.append(white + correlated[key] + space.start + space.walk * both)
    return np.array(variances)
