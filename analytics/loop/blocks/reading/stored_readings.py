"""Single readings of channels, and their ranges by the second; of many runs by one statement."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from analytics.loop.blocks.pieces import READINGS, Grid, SignalKey, rows_of
from analytics.loop.blocks.reading.channels import Readings
from analytics.loop.blocks.reading.stored_signals import FAR_NS, ChannelSource
from analytics.loop.blocks.run_blocks import SECOND_NS
from storage.sql.catalog import Catalog
from storage.sql.columns import numbers
from stream.batch import FloatArray, IntArray

MOST_READINGS = 500_000  # of the signals that are read together
_MOST_AHEAD = 2_000_000  # readings in memory before they are asked for; others are read when they are
_MOST_EXTREMES = 30
_VALUES = """
select t_ns, value from internal.samples_in($paths) where unit = $unit and signal = $signal
  and run = $run and t_ns between $first and $last and isfinite(value) order by t_ns
"""
_EXTREMES = "select w.number, (s.t_ns - w.t0_ns) / 1e9 as t_s, s.lo, s.hi from internal.rollup_1s_in($paths) s WANTED"


class StoredReadings:
    """Readings of the channels of a unit's runs, in the stored unit of measure."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._ahead: dict[tuple[SignalKey, Grid], tuple[IntArray, FloatArray]] = {}
        self._expected: dict[tuple[SignalKey, int], ChannelSource] = {}
        self._extremes: dict[tuple[SignalKey, int], tuple[FloatArray, FloatArray, FloatArray]] = {}

    def read_ahead(self, wanted: Sequence[tuple[ChannelSource, Grid]]) -> None:
        """Read signals that will be asked for, as many as fit into memory, by few statements.

        What was read ahead before is kept where it is wanted again, as a channel of the chamber.
        """
        asked = {(source.key, grid) for source, grid in wanted}
        self._ahead = {key: each for key, each in self._ahead.items() if key in asked}
        group: dict[SignalKey, Grid] = {}
        readings, total = 0, sum(len(value) for _, value in self._ahead.values())
        for source, grid in wanted:
            if (source.key, grid) in self._ahead or source.key in group:
                continue
            if source.samples > MOST_READINGS or total + source.samples > _MOST_AHEAD:
                continue
            if readings + source.samples > MOST_READINGS:
                self._read(group)
                group, readings = {}, 0
            group[source.key] = grid
            readings += source.samples
            total += source.samples
        self._read(group)

    def _read(self, grids: Mapping[SignalKey, Grid]) -> None:
        if not grids:
            return
        nothing = np.empty(0, dtype=np.int64), np.empty(0)
        self._ahead |= dict.fromkeys(grids.items(), nothing)
        for key, columns in rows_of(self._catalog, READINGS, grids, "t_ns"):
            self._ahead[key, grids[key]] = columns["t_ns"], columns["value"]

    def forget(self, unit: str | None = None) -> None:
        """Drop what was read ahead, of all units or of one."""
        self._ahead = {} if unit is None else {key: each for key, each in self._ahead.items() if key[0].unit != unit}
        self._expected.clear()

    def pieces(self, source: ChannelSource, grid: Grid) -> Iterator[tuple[IntArray, FloatArray]]:
        """Times (ns) and values of a signal in the time range of a grid, piece by piece in the order of time."""
        known = self._ahead.get((source.key, grid))
        if known is not None:
            yield known
            return
        asked = {**source.key._asdict(), "first": grid.first_ns, "last": grid.last_ns}
        paths = self._catalog.checked_paths_of([source.run], _VALUES)
        for batch in self._catalog.batches(_VALUES, {"paths": paths, **asked}):
            yield numbers(batch.column("t_ns")), numbers(batch.column("value"))

    def of(self, source: ChannelSource, grid: Grid) -> Readings:
        """Readings of a signal in the time range of a grid."""
        parts = list(self.pieces(source, grid))
        if not parts:
            return Readings(np.empty(0), np.empty(0))
        t_ns, value = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Readings((t_ns - grid.t0_ns) / SECOND_NS, value)

    def expect_extremes(self, wanted: Sequence[tuple[ChannelSource, int]]) -> None:
        """Announce the signals whose `extremes` will be asked for, in this order."""
        self._expected |= {(source.key, t0_ns): source for source, t0_ns in wanted}

    def extremes(self, source: ChannelSource, t0_ns: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Begin in seconds, least and greatest value of each second with readings; units of one run share them."""
        key = source.key, t0_ns
        if key not in self._extremes:
            self._read_extremes(source, t0_ns)
        return self._extremes[key]

    def _read_extremes(self, source: ChannelSource, t0_ns: int) -> None:
        """Those of a signal and of expected ones."""
        grids, readings = {source.key: Grid(t0_ns, -FAR_NS, FAR_NS)}, source.samples
        for (key, other_t0_ns), other in self._expected.items():
            if (key, other_t0_ns) in self._extremes or key in grids or len(grids) >= _MOST_EXTREMES:
                continue
            readings += other.samples
            if readings > MOST_READINGS:
                break
            grids[key] = Grid(other_t0_ns, -FAR_NS, FAR_NS)
        while self._extremes and len(self._extremes) + len(grids) > _MOST_EXTREMES:
            self._extremes.pop(next(iter(self._extremes)))
        self._extremes |= {(key, grid.t0_ns): (np.empty(0), np.empty(0), np.empty(0)) for key, grid in grids.items()}
        for key, columns in rows_of(self._catalog, _EXTREMES, grids, "t_s"):
            self._extremes[key, grids[key].t0_ns] = columns["t_s"], columns["lo"], columns["hi"]
