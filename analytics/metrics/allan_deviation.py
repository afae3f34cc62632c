"""Allan deviation at the averaging times that specifications limit."""

import contextlib
import itertools
from collections.abc import Iterator
from operator import itemgetter
from typing import Any

import numpy as np

from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal
from stream.batch import SampleBatch
from stream.errors import GyrofleetError
from stream.estimators.base import NoEstimate
from stream.estimators.block_means import BlockMeans
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.quantities import report_unit

_BLOCKS = 16
_LEAST_BLOCK = 6  # samples; means of fewer, now one more and now one less, have another deviation
_SAME_TAU = 0.01


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: the samples of a signal are read once, where a limit names an averaging time."""
    rows = catalog.reader(sql).read_all().to_pylist()
    for (unit, signal, run), asked in itertools.groupby(rows, itemgetter("unit", "signal", "run")):
        records = [_Record(row) for row in asked]
        with contextlib.ExitStack() as opened:
            pending = [opened.enter_context(contextlib.closing(each)) for each in records if each.answer is None]
            try:
                for batch in read_signal(catalog, find_signal(catalog, unit, signal, run)) if pending else ():
                    for record in pending:
                        record.update(batch)
            except GyrofleetError as error:  # as where raw rows were dropped
                for record in pending:
                    record.answer = {"reason": str(error)}
            for record in records:
                yield record.row | record.evaluate()


class _Record:
    """The evaluated part of a step, for one averaging time; its sums are held until the samples are past its end."""

    def __init__(self, row: dict[str, Any]) -> None:
        self.row = row
        self.answer: dict[str, Any] | None = None if row["reason"] is None else {}
        self._tau_s: float = row["tau_s"]
        self._means = BlockMeans(self._tau_s / _BLOCKS)
        self._overlap: FullOverlap | None = None

    def close(self) -> None:
        """Give up the sums."""
        if self._overlap is not None:
            self._overlap.close()

    def update(self, batch: SampleBatch) -> None:
        """Take in what lies inside the step."""
        if self.answer is not None:
            return
        times_ns = batch.time_array
        inside = np.flatnonzero((times_ns >= self.row["t_from_ns"]) & (times_ns <= self.row["t_to_ns"]))
        try:
            if len(inside):
                self._take(batch.part(int(inside[0]), int(inside[-1]) + 1))
        except GyrofleetError as error:
            self.answer = {"reason": str(error)}
        if self._overlap is not None and times_ns[0] > self.row["t_to_ns"]:
            self.evaluate()

    def _take(self, batch: SampleBatch) -> None:
        # means over a sixteenth of the averaging time, or the samples where that is too short for means
        is_long = self._tau_s * 1e9 / _BLOCKS >= _LEAST_BLOCK * batch.dt_ns
        found = self._means.push(batch) if is_long else batch
        if found is not None:
            self._overlap = self._overlap or FullOverlap()
            self._overlap.update(found)

    def evaluate(self) -> dict[str, Any]:
        """Return the deviation, or the reason that there is none."""
        if self.answer is None:
            self.answer = self._deviation()
            self.close()
        return self.answer

    def _deviation(self) -> dict[str, Any]:
        row, tau_s = self.row, self._tau_s
        if self._overlap is None:
            return {"reason": f"no mean over {tau_s / _BLOCKS:g} s has its samples"}
        try:
            interval_s = self._overlap.sample_interval_s
            most = max(1, round(tau_s / interval_s)) if interval_s else 1
            factors = [most, *(2**k for k in range(most.bit_length()) if 2**k < most)]
            points = self._overlap.evaluate(Deviation.OVERLAPPING_ALLAN, factors=factors)
        except GyrofleetError as error:
            return {"reason": str(error)}
        if isinstance(points, NoEstimate):
            return {"reason": points.reason}
        point = points[-1]
        if abs(point.tau_s - tau_s) > _SAME_TAU * tau_s:
            return {"reason": _why_none(tau_s, row["duration_s"], interval_s)}
        if point.value == 0:
            return {"reason": "all samples are alike: the output is frozen, or its resolution too coarse to show noise"}
        factor = abs(row["deg_per_h"]) / report_unit(row["output_unit"])[1]
        if row["is_no_noise"]:
            return {"value": point.value * factor}  # what its scatter is worth, the remark says
        found = {name: getattr(point, name) * factor for name in ("value", "lo", "hi")}
        return found | {"freedom": point.edf, "standard_uncertainty": found["value"] / (2 * point.edf) ** 0.5}


def _why_none(tau_s: float, duration_s: float, interval_s: float) -> str:
    intervals = tau_s / interval_s if interval_s else 1.0
    if 2 * tau_s < duration_s and abs(intervals - round(intervals)) > _SAME_TAU * intervals:
        return (
            f"there is no Allan deviation at {tau_s:g} s: the averaging time is no whole number of sample intervals of "
            f"{interval_s:g} s"
        )
    return (
        f"the record of {duration_s:.0f} s has no Allan deviation at {tau_s:g} s, of which it needs two averages one "
        "after the other"
    )
