"""Allan, Hadamard and modified Allan deviation of a finished record with full overlap (NIST SP 1065 5.2)."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stream.batch import SampleBatch
from stream.clock import contiguous_runs
from stream.closing import Closing
from stream.errors import EstimatorError
from stream.estimators.allan_variance import allan_point, check_points_per_octave
from stream.estimators.base import LEAST_SHARE, NoEstimate, Points, SignalInput, held_share
from stream.estimators.confidence import NOISE_EXPONENTS, least_edf
from stream.estimators.full_overlap.deviation_forms import FORMS, Deviation, squared_differences
from stream.estimators.full_overlap.prefix_record import PrefixRecord
from stream.estimators.noise.noise_exponent import Identified, identify

_MOST_SLOTS_PER_SAMPLE = 20
_SLOTS_FREE = 10**8
_EDF_STRIDE = 32
_LEAST_DIFFERENCE = 1e-150  # the squares of smaller numbers lose digits, or are 0
_QUANTITY = "deviations with full overlap"


class FullOverlap(SignalInput, Closing):
    """Deviations of a finished record at any averaging time with every possible window, in bounded memory.

    The sums of a record of more than 4 million samples lie in `folder` while it is evaluated, 8 bytes a sample, and 2
    more where one is missing nearby; in the system's folder for temporary files if none is named. The file has no name;
    `close` or leaving the ``with`` frees it.

    Notes
    -----
    With x_i the sum of the first i of N samples, m samples in tau, n terms in each sum, and i from 0 on,

    - adev, oadev: sum (x_(i+2m) - 2 x_(i+m) + x_i)**2 / (2 m**2 n), 5.2.2 and 5.2.4,
    - hdev, ohdev: sum (x_(i+3m) - 3 x_(i+2m) + 3 x_(i+m) - x_i)**2 / (6 m**2 n), 5.2.8 and 5.2.9,
    - mdev: sum_i (sum_(j=i)^(i+m-1) (x_(j+2m) - 2 x_(j+m) + x_j))**2 / (2 m**4 n), 5.2.5,

    are the variances; i advances by m in adev and hdev, by 1 in the others. The Hadamard deviation is insensitive to
    a linear drift of the samples; the modified Allan deviation separates quantisation from flicker of angle.

    Where samples are missing, a window counts if it holds at least 90 % of its samples and the mean of those it holds
    stands for all, and the lower bound allows for what this adds to white noise (`held_share`); in mdev the same holds
    for the inner sum. Values that are not finite are missing.

    Bounds are by chi-square with the least equivalent degrees of freedom of the noises that the curve leaves plausible
    for oadev (`noise_exponent`), of all noises for the others (`confidence`).

    Examples
    --------
    >>> from uuid import UUID
    >>> import numpy as np
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10**9, "deg/h",
    ...                     values=np.array([1.0, 3.0, 2.0, 6.0, 4.0]))
    >>> with FullOverlap() as record:
    ...     record.update(batch)
    ...     allan = record.evaluate(Deviation.OVERLAPPING_ALLAN)
    ...     hadamard = record.evaluate(Deviation.OVERLAPPING_HADAMARD)
    >>> [(point.tau_s, round(point.value, 6), point.n) for point in allan]
    [(1.0, 1.767767, 4), (2.0, 1.600781, 2)]
    >>> [(point.tau_s, round(point.value, 6), point.n) for point in hadamard]
    [(1.0, 1.972027, 3)]
    """

    confidence: float = 0.95

    def __init__(self, folder: Path | None = None) -> None:
        super().__init__()
        self._is_open = True
        self._prefix = PrefixRecord(folder)

    def close(self) -> None:
        """Free the memory and the file; nothing can be evaluated any more."""
        self._is_open = False
        self._prefix.close()

    @property
    def file_bytes(self) -> int:
        """Size of the temporary files, bytes."""
        return self._prefix.file_bytes

    def update(self, batch: SampleBatch) -> None:
        """Take in the next batch of the record.

        Raises an EstimatorError if the batch is of another signal, unit of measure or sample interval than those before
        it, or after `close`; and, closing the record, if far more slots than samples would be kept, or the disk is
        full.
        """
        who = batch.label
        if not self._is_open:
            raise EstimatorError(f"{who}: the record of its {_QUANTITY} is closed; begin a new one")
        if (batch.unit, batch.signal, batch.unit_of_measure) != self._signal:
            self._begin(batch, "record")
        pieces = self.tracker.place(batch)
        if self.tracker.irregular:
            return
        slots, most = self.tracker.next_slot, _MOST_SLOTS_PER_SAMPLE * self.samples + _SLOTS_FREE
        if slots > most:
            self.close()
            raise EstimatorError(
                f"{who}: {self.samples} samples spread over {slots} intervals of {self.sample_interval_s:g} s, {most} "
                "at most can be evaluated with full overlap; check the clock, or evaluate the parts before and after "
                "the gap on their own"
            )
        try:
            for first_slot, values in contiguous_runs(batch, pieces) if pieces else ():
                self._prefix.extend(first_slot, values)
        except OSError as error:
            self.close()
            raise EstimatorError(_no_room(who, error)) from error

    def evaluate(
        self, kind: Deviation, points_per_octave: int = 1, factors: Sequence[int] | None = None
    ) -> Points | NoEstimate:
        """Deviation at every averaging time that has at least one difference, shortest first; more may follow.

        Averaging times are those of `AllanDeviation` with 1, 2, 4 or 8 in an octave, or `factors` sample intervals, at
        least 1 each. Raises an EstimatorError if an argument is outside its range, there is no room on disk, or after
        `close`.
        """
        unit, signal, _ = self._signal
        who = f"unit {unit}, signal {signal}"
        if not self._is_open:
            raise EstimatorError(f"{who}: the record of its {_QUANTITY} is closed; evaluate before it is")
        wanted = self._wanted(kind, points_per_octave, factors)
        if self.tracker.irregular:
            return self._no_grid(FORMS[kind].name)
        try:
            record = self._prefix.record()
        except OSError as error:
            raise EstimatorError(_no_room(who, error)) from error
        if math.isnan(record.mean):
            return self._too_large()
        found = [(factor, *squared_differences(record, kind, factor)) for factor in wanted]
        found = [(factor, squares, windows) for factor, squares, windows in found if windows]
        variances = [squares / (FORMS[kind].norm * n) / float(factor) ** 2 for factor, squares, n in found]
        if not all(math.isfinite(variance * self._factor) for variance in variances):
            return self._too_large()
        if max(variances, default=1.0) < _LEAST_DIFFERENCE**2 and 0.0 < np.abs(record.sums).max() < _LEAST_DIFFERENCE:
            return self._too_small()
        factors, windows = [factor for factor, _, _ in found], [n for _, _, n in found]
        return self._points(kind, factors, variances, windows) or NoEstimate(self._too_little(kind, wanted))

    def longest_tau_s(self, kind: Deviation) -> float:
        """The longest averaging time that the record is long enough for, seconds; 0 where there is none."""
        return self._prefix.slots // FORMS[kind].reach * self.sample_interval_s

    def _wanted(self, kind: Deviation, points_per_octave: int, factors: Sequence[int] | None) -> list[int]:
        """Averaging factors that the record is long enough for."""
        largest = self._prefix.slots // FORMS[kind].reach
        if factors is None:
            return averaging_factors(points_per_octave, largest)
        if min(factors, default=1) < 1:
            raise EstimatorError(f"an averaging time of {min(factors)} sample intervals: it takes 1 or more")
        return sorted({factor for factor in map(int, factors) if factor <= largest})

    def _points(self, kind: Deviation, factors: list[int], variances: list[float], windows: list[int]) -> Points:
        form = FORMS[kind]
        strides = [_stride(factor) if form.is_overlapped else 1 for factor in factors]
        freedom = [
            max(1, n * stride // factor) if form.is_overlapped else n
            for n, stride, factor in zip(windows, strides, factors, strict=True)
        ]
        if kind is Deviation.OVERLAPPING_ALLAN and factors:
            noises = identify(np.array(factors), np.array(variances), np.array(freedom), np.array(strides))
        else:
            filtered = [1 if kind is Deviation.MODIFIED_ALLAN else factor for factor in factors]
            edfs = [least_edf(*each, d=len(form.weights)) for each in zip(filtered, freedom, strides, strict=True)]
            noises = tuple(Identified(exponent=0, plausible=NOISE_EXPONENTS, edf=edf) for edf in edfs)
        held = held_share(self.samples, self.missing)
        return tuple(
            allan_point(
                factor * self.tracker.dt_ns / 1e9,
                math.sqrt(variance) * self._factor,
                n,
                noise,
                self.confidence,
                held if factor > 1 else 1.0,
            )
            for factor, variance, n, noise in zip(factors, variances, windows, noises, strict=True)
        )

    def _too_little(self, kind: Deviation, wanted: list[int]) -> str:
        reach = FORMS[kind].reach
        if not wanted and (longest_s := self.longest_tau_s(kind)):
            return (
                f"{reach} averages one after the other are needed, so that no averaging time of this record is longer "
                f"than {longest_s:g} s"
            )
        if not wanted:
            return f"{reach} samples for each in an average needed, {self._prefix.slots} seen"
        return (
            f"{reach} neighbouring averages with {LEAST_SHARE:.0%} of their samples needed, none seen: "
            f"{self.samples} samples, {self.missing} missing"
        )


def _stride(factor: int) -> int:
    """Windows in a tau that give the same degrees of freedom as all windows to 0.5 %, and whose sums are short."""
    while factor >= _EDF_STRIDE:
        factor //= 2
    return factor


def averaging_factors(points_per_octave: int, largest: int) -> list[int]:
    """Averaging times in sample intervals, those of `AllanDeviation`, up to the largest.

    >>> averaging_factors(2, 50)
    [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48]
    """
    check_points_per_octave(points_per_octave)
    octaves = [1 << k for k in range(largest.bit_length())]
    steps = [(octave, max(1, octave // points_per_octave)) for octave in octaves]
    return [factor for octave, step in steps for factor in range(octave, 2 * octave, step) if factor <= largest]


def _no_room(who: str, error: OSError) -> str:
    return (
        f"{who}: the {_QUANTITY} of a record this long need room on disk for its sums: {error}; "
        "free some, or name another folder"
    )
