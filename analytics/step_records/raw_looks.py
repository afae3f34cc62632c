"""Raw samples of records that are reduced from means of seconds: a look for values far too frequent, or repeated."""

from collections import defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from analytics.step_records.evaluated_signal import EvaluatedSignal
from storage.lake.tables import SAMPLES_FILE, damaged
from storage.sql.catalog import Catalog
from storage.sql.columns import numbers
from storage.sql.footers import UNREADABLE, Footer
from storage.sql.reading import rows_at_beginnings
from stream.batch import FloatArray, IntArray
from stream.defects.outliers import FEWEST_LEVELS, is_apart, piled_share

if TYPE_CHECKING:
    import pyarrow.parquet as pq

_DECODED, _LOOK, _BLOCKS, _BLOCK = 4096, 2000, 20, 50_000
_LEAST_AT_END, _FEWEST_AT_END, _FEW = 0.01, 3, 200
_PARTS = """
select run, unit, signal, filename, channel, is_counts, scale, "offset" from internal.lake_channel_parts
where is_kept and filename is not null and run in $runs and unit in $units and signal in $signals
order by all
"""
# all samples of a window, or blocks of a width, evenly spread
_SPREAD = """
select value from internal.samples_in($paths)
where run = $run and unit = $unit and signal = $signal and t_ns between $first and $last
  and (t_ns - $first) % $every < $width and isfinite(value)
order by t_ns, seq
"""


class _Stretch(NamedTuple):
    path: str
    channel: int
    columns: tuple[str, ...]
    scale: float
    offset: float


class RawLooks:
    """Looks at raw samples of signals, which are best asked for one signal after another."""

    def __init__(self, catalog: Catalog, signals: Sequence[EvaluatedSignal]) -> None:
        self._catalog = catalog
        self._stretches: defaultdict[tuple[str, str, str], list[_Stretch]] = defaultdict(list)
        names = {f"{name}s": sorted({getattr(each, name) for each in signals}) for name in ("run", "unit", "signal")}
        for run, unit, signal, filename, channel, is_counts, scale, offset in catalog.rows(_PARTS, names):
            path = f"{filename.rpartition('/')[0]}/{SAMPLES_FILE}"
            as_stored = (("base", "above"), scale, offset) if is_counts else (("value",), 1.0, 0.0)
            self._stretches[run, unit, signal].append(_Stretch(path, channel, *as_stored))
        self._of: EvaluatedSignal | None = None
        self._t_ns, self._values = np.empty(0, np.int64), np.empty(0)
        self._files = ExitStack()
        self._path = ""
        self._file: tuple[pq.ParquetFile, Footer] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.close()

    def samples(self, signal: EvaluatedSignal, window: tuple[int, int], lo: FloatArray, hi: FloatArray) -> FloatArray:
        """Samples of a window of a signal, of whose seconds `lo` and `hi` are the least and greatest values.

        A look is at its beginning, and that of row groups of the lake in it, which cost little to read: where 0 is
        inside the noise, by which lost samples are written, where the resolution is coarse, and where an end of the
        range is reached in many seconds. Where one value is far too frequent there, or such an end is no level of a
        coarse output, the samples are all of a million, or as many in blocks evenly spread over the window; else those
        of the look at a coarse output, or none.
        """
        ends = _frequent_ends(lo, hi)
        is_coarse = np.unique(hi[:_FEW]).size < FEWEST_LEVELS
        if lo.min() == hi.max() or not (ends or is_coarse or lo.min() <= 0.0 <= hi.max()):
            return np.empty(0)
        own = self.beginnings(signal, window)
        look = _thinned(own)
        if _may_be_piled(look) or (look.size and any(_is_no_level(end, look) for end in ends)):
            return self._spread(signal, window)
        return own if is_coarse else np.empty(0)

    def beginnings(self, signal: EvaluatedSignal, window: tuple[int, int]) -> FloatArray:
        """Samples of a window of a signal at its beginning, and at that of row groups in it, in their order."""
        if self._of is not signal:
            self._of = signal
            self._t_ns, self._values = self._beginnings(signal)
        return self._values[(self._t_ns >= window[0]) & (self._t_ns <= window[1])]

    def _beginnings(self, signal: EvaluatedSignal) -> tuple[IntArray, FloatArray]:
        times, values = [np.empty(0, np.int64)], [np.empty(0)]
        own = self._stretches[signal.run, signal.unit, signal.signal]
        for each in own:
            if self._file is None or self._path != each.path:
                self._files.close()
                self._path, self._file = each.path, self._catalog.source.open_table(each.path)
                self._files.enter_context(self._file[0])
            rows = _DECODED // len(own) + 1
            try:
                found = rows_at_beginnings(*self._file, each.channel, each.columns, signal.windows, rows, signal.dt_ns)
            except UNREADABLE as error:
                raise damaged(Path(each.path), error) from error
            is_finite = np.isfinite(found[1])
            times.append(found[0][is_finite])
            values.append(found[1][is_finite] * each.scale + each.offset)
        return np.concatenate(times), np.concatenate(values)

    def _spread(self, signal: EvaluatedSignal, window: tuple[int, int]) -> FloatArray:
        width_ns = _BLOCK * max(signal.dt_ns, 1)
        given = {
            "paths": self._catalog.paths_of([signal.run]), "run": signal.run, "unit": signal.unit,
            "signal": signal.signal, "first": window[0], "last": window[1], "width": width_ns,
            "every": max((window[1] - window[0]) // _BLOCKS, width_ns),
        }  # fmt: skip
        return np.asarray(numbers(self._catalog.reader(_SPREAD, given).read_all().column(0)), np.float64)


def _thinned(values: FloatArray) -> FloatArray:
    """At most `_LOOK` of some values, in blocks of consecutive ones."""
    if values.size <= _LOOK:
        return values
    size = _LOOK // _BLOCKS
    begins = np.linspace(0, values.size - size, _BLOCKS).astype(np.int64)
    return np.asarray(values[(begins[:, None] + np.arange(size)).ravel()])


def _may_be_piled(look: FloatArray) -> bool:
    """Whether one value is far too frequent, which is known at once where none holds a hundredth."""
    few = look.size // 100
    ordered = np.sort(look)
    return bool((ordered[few:] == ordered[: look.size - few]).any()) and piled_share(look)[0] > 0


def _frequent_ends(lo: FloatArray, hi: FloatArray) -> list[float]:
    """Ends of the range that are reached in many seconds, and in more than the value next to it.

    >>> noise = np.random.default_rng(1).standard_normal((1000, 100))
    >>> [_frequent_ends(noise.min(1), np.minimum(noise.max(1), most)) for most in (2.0, 9.0)]
    [[2.0], []]
    """
    found = []
    for sign, ends in ((1.0, hi), (-1.0, -lo)):
        end = ends.max()
        others = ends[ends < end]
        next_to_it = np.count_nonzero(others == others.max(initial=-np.inf))
        if ends.size - others.size > max(_FEWEST_AT_END, _LEAST_AT_END * ends.size, next_to_it):
            found.append(sign * float(end))
    return found


def _is_no_level(end: float, look: FloatArray) -> bool:
    """Whether an end of the range is not one that a coarse output reaches by its noise: of few levels, a near one."""
    levels = np.unique(np.append(look, end))
    return levels.size > FEWEST_LEVELS or is_apart(levels, int(np.searchsorted(levels, end)))
