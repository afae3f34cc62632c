"""Samples that repeat the one before exactly, more often than resolution and noise explain."""

import math

import numpy as np

from stream.batch import FloatArray

_BLOCK, _MOST_BLOCKS = 200, 100
_FEWEST_CHANGES = 10  # of a block
_FEWEST_COUNTED = 5  # of a block whose repeats are counted once there are any
_LONGEST = 20  # repeats in a row, beyond which the output stands still
_FINE = 0.05  # repeats that resolution and noise explain, beyond which the resolution is too coarse to tell
_FEWEST, _LEAST, _TIMES, _MARGIN = 10, 0.01, 3.0, 5.0
_PER_MEDIAN = 1.4826


def repeated_share(values: FloatArray) -> float:
    """Least share of the samples that repeat the one before, as of a logger faster than the gyro; 0 where explained.

    Of noise with differences of the deviation sigma that is rounded to steps q, neighbours are alike with a probability
    of q/(sigma sqrt(2 pi)), which for white noise of the deviation s is q/(2 s sqrt(pi)). Neither q nor a distribution
    is assumed: two samples of a block taken at random are alike with the probability C, which is q/(2 s sqrt(pi)) as
    well, so that C sqrt(2) s/sigma is explained, of samples that are correlated as of white ones. Repeats are left out
    of s and sigma, which are of blocks of 200 samples. C is that of the values that change or of those that repeat,
    whichever is more: in a quiet part of a noisy record the same few values repeat. With the smallest move as q no less
    is explained. Blocks in which that is more than a twentieth, as of a temperature that moves by single steps, and
    repeats of more than 20 in a row are not looked at. There are repeats beyond that from 10 and 1 % of the samples on,
    and three times what is explained, with five of its deviations.

    Of a share p beyond what is explained, c, p + (1 - p)c of the samples are repeats. The share is that p of all
    blocks, of coarse ones as well: a lower bound, as c is no less than is explained and long rows are not counted.

    >>> noise = np.random.default_rng(1).standard_normal(4000)
    >>> fourth = np.repeat(noise[:3000], np.tile([1, 1, 2], 1000))
    >>> round(repeated_share(fourth), 3), repeated_share(np.round(noise, 1)), repeated_share(np.round(fourth))
    (0.247, 0.0, 0.0)
    """
    moves = np.diff(values)
    if np.count_nonzero(moves == 0.0) < max(_FEWEST, _LEAST * values.size):
        return 0.0
    found = explained = beyond = 0.0
    size = min(_BLOCK, moves.size)
    blocks = min(moves.size // size, _MOST_BLOCKS)
    for begin in np.linspace(0, moves.size - size, blocks).astype(np.int64):
        block = moves[begin : begin + size]
        changes = np.flatnonzero(block)
        if changes.size < _FEWEST_COUNTED:
            continue
        rows = np.diff(np.r_[-1, changes, size]) - 1
        repeats = float(rows[rows <= _LONGEST].sum())
        repeated = begin + changes[rows[1:] > 0] + 1
        by_chance = _explained(values[begin + changes], values[repeated], block[changes])
        if by_chance < 1.0:
            beyond += max(0.0, repeats - by_chance * size) / (1.0 - by_chance)
        if by_chance <= _FINE and changes.size >= _FEWEST_CHANGES:
            found += repeats
            explained += by_chance * size
    usual, seen = _TIMES * explained, size * blocks
    is_beyond = found > max(_FEWEST, _LEAST * seen, usual + _MARGIN * math.sqrt(usual))
    return beyond / seen if is_beyond else 0.0


def _explained(changing: FloatArray, repeated: FloatArray, moves: FloatArray) -> float:
    """Probability that neighbours are alike by resolution and noise, at most 1."""
    sizes = np.abs(moves)
    sigma = _PER_MEDIAN * float(np.median(sizes))
    of_values = max(_alike(changing), _alike(repeated)) * math.sqrt(2.0) * float(changing.std())
    return min(1.0, max(of_values, float(sizes.min()) / math.sqrt(2.0 * math.pi)) / sigma)


def _alike(values: FloatArray) -> float:
    """Probability that two of some values are alike."""
    counts = np.unique(values, return_counts=True)[1]
    return float((counts * (counts - 1)).sum()) / max(values.size * (values.size - 1), 1)
