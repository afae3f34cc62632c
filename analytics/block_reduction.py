"""From the store to blocks: runs of a unit as block means of its signal, with the channels of unit and station."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from analytics.block_angles import AngleBlocks, without_aliases
from analytics.block_channels import joined_blocks, joined_readings, readings_of, standard_unit
from analytics.block_checks import Note, check_channels, check_clocks
from analytics.block_derived import derive
from analytics.block_means import SECOND_NS, Blocks, Grid, block_means
from analytics.block_sources import Source, sources_of
from analytics.run_blocks import Channel, RunBlocks
from storage.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput, NotFound
from stream.quantities import conversion, report_unit

BLOCK_S = 30.0
_DENSE = 4  # readings a block from which on block means are taken


@dataclass(frozen=True)
class Reduction:
    """What came of a unit's record.

    Parameters
    ----------
    runs : tuple of RunBlocks
        In the order of time.
    notes : tuple of Note
        What was left out, converted, supposed or looks wrong.
    """

    runs: tuple[RunBlocks, ...]
    notes: tuple[Note, ...] = ()

    @property
    def limits(self) -> tuple[str, ...]:
        """The notes that limit what can be concluded, as sentences."""
        return tuple(note.text for note in self.notes if note.is_limit)


class BlockReducer:
    """Reduces units of a store one after the other; readings of the station are kept for the next unit of a run.

    Parameters
    ----------
    catalog : Catalog
        The store.
    signal : str
        Which signal.
    block_s : float
        Length of a block, seconds.
    runs : collection of str, optional
        Which runs; all that have the signal where none are named.
    since_ns, until_ns : int, optional
        Samples from one moment to another only.
    tolerance_s : float, optional
        How far from a reading a channel is still believed; by default a block, or the channel's own interval where that
        is longer.

    Raises
    ------
    BadInput
        If the length of a block or the tolerance is no positive number.

    Examples
    --------
    >>> BlockReducer(None, "rate", block_s=0.0)
    Traceback (most recent call last):
    stream.errors.BadInput: blocks of 0 s: give a positive number of seconds
    """

    def __init__(
        self,
        catalog: Catalog,
        signal: str,
        *,
        block_s: float = BLOCK_S,
        runs: Iterable[str] | None = None,
        since_ns: int | None = None,
        until_ns: int | None = None,
        tolerance_s: float | None = None,
    ) -> None:
        if not (np.isfinite(block_s) and block_s > 0):
            raise BadInput(f"blocks of {block_s:g} s: give a positive number of seconds")
        if tolerance_s is not None and not (np.isfinite(tolerance_s) and tolerance_s > 0):
            raise BadInput(f"a tolerance of {tolerance_s:g} s: give a positive number of seconds")
        self._catalog = catalog
        self._signal = signal
        self._block_s = block_s
        self._block_ns = max(1, round(block_s * SECOND_NS))
        self._wanted = None if runs is None else set(runs)
        self._since_ns, self._until_ns = since_ns, until_ns
        self._tolerance_s = tolerance_s
        self._station: dict[tuple[str, str], dict[str, Blocks]] = {}

    def reduce(self, unit: str) -> Reduction:
        """The runs of a unit as blocks, and what is to be said of them.

        Raises
        ------
        NotFound
            If the store has nothing of the signal in that time, or the runs.
        """
        spans, dates, first_day_ns = self._spans(unit)
        grids = self._grids(spans)
        found = block_means(self._catalog, unit, self._signal, grids, self._block_s)
        order = sorted(found, key=lambda run: spans[run][0])
        if not order:
            raise NotFound(f"unit {unit}, signal {self._signal}: no sample lies in the time that was asked for")
        sources, notes = sources_of(self._catalog, unit, self._signal, order)
        notes += check_clocks(self._catalog, unit, self._signal, _instruments(sources, unit))
        runs, intervals = [], []
        for run in order:
            blocks = self._with_value(unit, run, found[run], grids[run], spans[run], is_date_known=dates[run])
            intervals.append({each.name: each.interval_s for each in sources[run]})
            runs.append(replace(blocks, channels=self._channels(found[run], sources[run], grids, blocks)))
        notes += self._not_finite(runs, spans)
        return self._finished(unit, runs, intervals, first_day_ns, notes)
