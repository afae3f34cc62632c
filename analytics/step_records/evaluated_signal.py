"""A signal of a run with its stretches that are evaluated."""

from collections.abc import Iterator
from typing import NamedTuple

from analytics.step_records.integrated_output import is_integrated

# A stretch of more samples is reduced from the store's means of 1 s, over the whole seconds within it: fast for months
# of samples, and possible where raw samples were dropped.
MOST_RAW = 20_000
SECOND_NS = 1_000_000_000
# In a shorter stretch the whole seconds are too small a part, or none: irregular samples are used as they are.
SHORT_NS = 10 * SECOND_NS


class EvaluatedSignal(NamedTuple):
    """A signal of a run, and those of its evaluated stretches that are read from raw samples, or from means of 1 s."""

    run: str
    unit: str
    signal: str
    unit_of_measure: str
    dt_ns: int
    irregular: bool
    samples: int
    kept_raw: int
    step: float
    windows: tuple[tuple[int, int], ...]
    is_raw: bool = True

    def halves(self) -> Iterator["EvaluatedSignal"]:
        """The stretches of a signal that are read from raw samples, and the others, where there are any."""
        raw = [self._is_raw(window) for window in self.windows]
        for is_raw in (True, False):
            windows = tuple(window for window, each in zip(self.windows, raw, strict=True) if each == is_raw)
            if windows:
                yield self._replace(windows=windows, is_raw=is_raw)

    def _is_raw(self, window: tuple[int, int]) -> bool:
        expected = (window[1] - window[0]) / max(self.dt_ns, 1)
        is_slow = self.dt_ns >= SECOND_NS // 2
        is_gridded = not self.irregular or window[1] - window[0] < SHORT_NS
        is_short = is_slow or is_integrated(self.signal) or (expected <= MOST_RAW and is_gridded)
        return self.kept_raw == self.samples and is_short

    @property
    def rows(self) -> float:
        """Rows of its stretches."""
        return sum(max(end - start, 0) for start, end in self.windows) / self._row_ns

    @property
    def all_rows(self) -> float:
        """Rows of the whole signal."""
        return self.samples * max(self.dt_ns, 1) / self._row_ns

    @property
    def _row_ns(self) -> int:
        return max(self.dt_ns, 1) if self.is_raw else SECOND_NS
