"""The Allan deviation of a recorded signal over a rolling window."""

import math
from dataclasses import dataclass

from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal
from stream.errors import NotEnoughData
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.rolling_window import RollingWindow, WindowEstimate
from stream.terminal.result_table import ResultTable

_SHOWN_TAUS = 8
_SHOWN_ROWS = 40


@dataclass(frozen=True)
class RollingAllan:
    """Dynamic Allan deviation: a row for each window, a column for each averaging time."""

    unit: str
    signal: str
    run: str
    unit_of_measure: str  # of `adev`, `lo` and `hi`
    window_s: float
    step_s: float
    start_h: tuple[float, ...]  # beginning of each window, hours since the first sample
    samples: tuple[int, ...]
    missing: tuple[int, ...]
    tau_s: tuple[float, ...]  # averaging times, increasing
    # adev, lo, hi: shape (windows, taus); deviation and its 95 % bounds; None where a window is too short or has gaps
    adev: tuple[tuple[float | None, ...], ...]
    lo: tuple[tuple[float | None, ...], ...]
    hi: tuple[tuple[float | None, ...], ...]

    def table(self) -> ResultTable:
        """Rows of windows at some of the averaging times, for the terminal."""
        every = math.ceil(len(self.tau_s) / _SHOWN_TAUS)
        columns = range(0, len(self.tau_s), every)
        rows = range(0, len(self.start_h), math.ceil(len(self.start_h) / _SHOWN_ROWS))
        is_all = len(rows) == len(self.start_h) and every == 1
        left_out = f"; --json gives {'the limits' if is_all else 'all windows and times, with limits'}"
        table = ResultTable(
            title=f"Rolling Allan deviation (动态 Allan 标准差) of {self.unit} {self.signal}, run {self.run}",
            caption=f"{len(self.start_h)} windows of {self.window_s / 3600:g} h every "
            f"{self.step_s / 3600:g} h; deviations in {self.unit_of_measure}{left_out}",
        )
        table.add_column("from h", justify="right")
        for column in columns:
            table.add_column(f"{self.tau_s[column]:g} s", justify="right")
        for row in rows:
            cells = [self.adev[row][column] for column in columns]
            table.add_row(f"{self.start_h[row]:.4g}", *("" if cell is None else f"{cell:.4g}" for cell in cells))
        return table


def rolling_allan(
    catalog: Catalog, unit: str, signal: str, run: str | None = None, *, window_s: float, step_s: float,
    points_per_octave: int = 1,
) -> RollingAllan:  # fmt: skip
    """Overlapping Allan deviation of a signal in the store over a rolling window.

    Without a run it is of the longest record; the window is a whole number of steps; `points_per_octave`: 1, 2, 4 or 8.
    """
    record = find_signal(catalog, unit, signal, run)
    rolling = RollingWindow(lambda: AllanDeviation(points_per_octave), window_s, step_s)
    windows: list[WindowEstimate] = []
    first_ns = last_ns = None
    for batch in read_signal(catalog, record):
        first_ns = int(batch.time_array.min()) if first_ns is None else first_ns
        last_ns = batch.last_ns
        windows += rolling.update(batch)
    windows += rolling.finish()
    held = [each for each in windows if not isinstance(each.estimate, NoEstimate)]
    if not held or first_ns is None or last_ns is None:
        length_s = 0.0 if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9
        why = next((each.estimate.reason for each in windows if isinstance(each.estimate, NoEstimate)), None)
        raise NotEnoughData(
            f"unit {unit}, signal {signal}, run {record.run}: no Allan deviation of a window of {window_s:g} s: "
            f"{why or f'the record has {length_s:g} s; give a shorter --rolling'}"
        )
    curves = [() if isinstance(each.estimate, NoEstimate) else each.estimate for each in windows]
    taus_s = sorted({point.tau_s for curve in curves for point in curve})
    by_tau = [{point.tau_s: point for point in curve} for curve in curves]
    columns = {
        name: tuple(tuple(getattr(each.get(tau_s), name, None) for tau_s in taus_s) for each in by_tau)
        for name in ("value", "lo", "hi")
    }
    return RollingAllan(
        unit=unit, signal=signal, run=record.run, unit_of_measure=rolling.unit_of_measure, window_s=window_s,
        step_s=step_s, start_h=tuple((each.start_ns - first_ns) / 1e9 / 3600 for each in windows),
        samples=tuple(each.samples for each in windows), missing=tuple(each.missing for each in windows),
        tau_s=tuple(taus_s), adev=columns["value"], lo=columns["lo"], hi=columns["hi"],
    )  # fmt: skip
