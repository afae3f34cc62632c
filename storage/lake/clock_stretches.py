"""Stretches of a channel's clock: the least delay of a source's messages, arrival minus source time, per minute.

A delay is at least the clock offset plus the least travel time, so that the least of a stretch is the lower envelope. A
stretch ends with the minute of the recorder's clock, and where the source's time leaps.
"""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from storage.lake.tables import CLOCK_COLUMNS
from stream.batch import BoolArray, IntArray

STRETCH_NS = 60_000_000_000
_LEAP_NS = 1_000_000
_IRREGULAR_LEAP_NS = 10_000_000_000


class Messages:
    """Numbers, times and arrivals of messages in a segment, those of one channel in the order of arrival."""

    def __init__(self, rows: IntArray) -> None:
        self.rows = rows
        self.seq, self.n, self.t0_ns, self.last_ns, self.dt_ns, self.arrival_ns = rows.T


def leaps(messages: Messages, irregular: BoolArray) -> BoolArray:
    """Whether the source's time leaps before each message: backwards, or beyond what the numbers imply."""
    step_ns = np.zeros(len(messages.seq), np.int64)
    step_ns[1:] = (
        messages.t0_ns[1:]
        - messages.last_ns[:-1]
        - messages.dt_ns[:-1] * (messages.seq[1:] - messages.seq[:-1] - messages.n[:-1] + 1)
    )
    leaps_at = np.abs(step_ns) > messages.dt_ns // 2 + _LEAP_NS
    if irregular.any():
        is_leap = (step_ns > _IRREGULAR_LEAP_NS) | (step_ns <= -messages.dt_ns - _LEAP_NS)
        leaps_at = np.where(irregular, is_leap, leaps_at)
    return np.asarray(leaps_at, np.bool_)


def clock_rows(
    messages: Messages, backward: IntArray, backward_most_ns: IntArray, begins: IntArray, irregular: BoolArray
) -> tuple[IntArray, tuple[IntArray, ...]]:
    """Stretches of several channels, whose messages begin at `begins`: the place of each one's channel, and columns.

    `backward` and `backward_most_ns` are, per message, the number of samples not later than the one before, and the
    largest step. Samples of messages that are `irregular` are on no grid.
    """
    delay_ns = messages.arrival_ns - messages.last_ns
    minute = messages.arrival_ns // STRETCH_NS
    is_first = leaps(messages, irregular)
    is_first[1:] |= minute[1:] != minute[:-1]
    is_first[begins] = True
    starts = np.flatnonzero(is_first)
    ends = np.append(starts[1:], len(minute)) - 1
    least_ns = np.minimum.reduceat(delay_ns, starts)
    index = np.arange(len(minute))
    at = np.minimum.reduceat(np.where(delay_ns == least_ns[np.cumsum(is_first) - 1], index, len(index)), starts)
    return np.searchsorted(begins, starts, side="right") - 1, (
        messages.seq[starts], ends - starts + 1, messages.t0_ns[starts],
        messages.last_ns[ends], messages.arrival_ns[starts], messages.arrival_ns[ends], messages.last_ns[at],
        least_ns, np.add.reduceat(backward, starts), np.maximum.reduceat(backward_most_ns, starts),
    )  # fmt: skip


def clock_table(channels: Sequence[tuple[IntArray, tuple[IntArray, ...]]]) -> pa.Table:
    """Rows of the stretches of channels, from the number of each one's channel and columns."""
    if not channels:
        return CLOCK_COLUMNS.empty_table()
    numbers, rows = zip(*channels, strict=True)
    columns = [np.concatenate(numbers), *(np.concatenate(column) for column in zip(*rows, strict=True))]
    return pa.Table.from_arrays([pa.array(column) for column in columns], schema=CLOCK_COLUMNS)
