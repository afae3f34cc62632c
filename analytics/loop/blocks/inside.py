"""What a channel does inside the blocks in which it moves: a step of a table's rate is no scatter about a mean."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from analytics.loop.blocks.piece_slopes import MOVES, WIDE, Slopes, is_noise
from stream.batch import BoolArray, FloatArray, IntArray

_LEAST_OF_RANGE = 1e-3  # the same, of the range of the means
_EVEN = 0.05  # of the spread of readings on a ramp, by which theirs may differ
_MOST_PIECES = 500_000  # of a channel of a run, 32 bytes each


@dataclass(frozen=True)
class Inside:
    """Pieces, such as seconds, of the blocks in which a channel moves; each shape (pieces,)."""

    row: IntArray  # number of the block, not decreasing
    n: FloatArray  # readings in each
    mean: FloatArray
    spread: FloatArray  # standard deviation of the readings in each
    slope_per_s: FloatArray | None = None  # mean rate of change in each
    is_even: BoolArray | None = None  # whether the readings are spread evenly, as on a ramp, and not about the mean
    further: FloatArray | None = None  # shape (pieces, orders): mean second, third, ... derivatives

    def scaled(self, factor: float | FloatArray, offset: float = 0.0) -> Self:
        """In another unit; a factor of each block as an array."""
        own = factor if isinstance(factor, float) else factor[self.row]
        slope, further = (None if each is None else (each.T * own).T for each in (self.slope_per_s, self.further))
        mean, spread = self.mean * own + offset, self.spread * np.abs(own)
        return replace(self, mean=mean, spread=spread, slope_per_s=slope, further=further)

    def later(self, factors: FloatArray) -> Self:
        """Means over other times; `factors` of the mean derivatives, from the first on, of each block."""
        if self.slope_per_s is None or self.further is None:
            return self
        own = factors[self.row]
        return replace(self, mean=self.mean + own[:, 0] * self.slope_per_s + (own[:, 1:] * self.further).sum(axis=1))

    def at(self, rows: IntArray) -> Self:
        """Pieces at the rows that these blocks have elsewhere, increasing; those of a row below 0 are left out.

        >>> one = np.ones(3)
        >>> inside = Inside(np.array([1, 1, 4]), one, one, one)
        >>> inside.at(np.array([0, -1, 1, 2, 3])).row
        array([3])
        """
        row = rows[self.row]
        kept = row >= 0
        slope, further = (None if each is None else each[kept] for each in (self.slope_per_s, self.further))
        even = None if self.is_even is None else self.is_even[kept]
        return replace(
            self, row=row[kept], n=self.n[kept], mean=self.mean[kept], spread=self.spread[kept], slope_per_s=slope,
            is_even=even, further=further,
        )  # fmt: skip

    def part(self, rows: BoolArray | slice, blocks: int) -> Self:
        """Pieces of some of so many blocks."""
        chosen = np.arange(blocks)[rows]
        new = np.full(blocks, -1)
        new[chosen] = np.arange(chosen.size)
        return self.at(new)

    def means(self, value: FloatArray, of_blocks: FloatArray) -> FloatArray:
        """Means over blocks of a value of each piece, in place of those of whole blocks, shape (blocks, ...)."""
        blocks = len(of_blocks)
        count = np.bincount(self.row, self.n, minlength=blocks)
        has_pieces = count > 0
        total = np.zeros_like(of_blocks)
        np.add.at(total, self.row, (self.n * value.T).T)
        found = (total.T / np.where(has_pieces, count, 1.0)).T
        return np.where(has_pieces if of_blocks.ndim == 1 else has_pieces[:, None], found, of_blocks)


def inside_of(
    number: IntArray, n: IntArray, mean: FloatArray, m2: FloatArray, blocks: tuple[FloatArray, FloatArray, BoolArray],
    slopes: Slopes | None = None,
) -> Inside | None:  # fmt: skip
    """Pieces of the blocks in which a channel moves, None where it does in none.

    It moves in a block whose spread is far above that of most blocks, as at a step; in all wide blocks if squares of
    successive differences of the pieces are not twice their variance, as in noise: a table that swings has no quiet
    block. `number` is the block of each piece, `m2` its sum of squares about its mean; `blocks` are the mean and
    spread of each block, and whether an outlier is in it. Of too many pieces the widest blocks have theirs.
    """
    of_block, spread, is_far = blocks
    known = np.where(is_far, np.nan, spread)
    finite = np.isfinite(known) & np.isfinite(of_block)
    if not finite.any():
        return None
    usual = float(np.quantile(known[finite], 0.25))
    full = float(np.ptp(of_block[finite]))
    least = max(MOVES * usual, _LEAST_OF_RANGE * full)
    pieces = np.bincount(number, minlength=spread.size)
    if not is_noise(number, mean, pieces):
        least = min(least, WIDE * full)
    moves = finite & (spread > least) & (pieces > 1)
    if pieces[moves].sum() > _MOST_PIECES:
        widest = np.flatnonzero(moves)[np.argsort(-spread[moves], kind="stable")]
        moves[widest[np.cumsum(pieces[widest]) > _MOST_PIECES]] = False
    chosen = moves[number]
    if not chosen.any():
        return None
    spreads = np.sqrt(m2[chosen] / n[chosen])
    found = Inside(number[chosen], n[chosen].astype(np.float64), mean[chosen], spreads)
    if slopes is None:
        return found
    slope = slopes.of_pieces[chosen]
    even = np.abs(slope) * slopes.piece_s * np.sqrt((1.0 - n[chosen] ** -2.0) / 12.0)
    is_even = (np.abs(spreads - even) <= _EVEN * even) & (n[chosen] > 1)
    return replace(found, slope_per_s=slope, is_even=is_even, further=slopes.further_of_pieces[chosen])
