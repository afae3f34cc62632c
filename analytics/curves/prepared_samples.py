"""Samples of a record as its spectrum takes them: outliers and short gaps bridged, slow changes subtracted."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import msgspec
import numpy as np
import numpy.typing as npt

from analytics.curves.slow_change import SlowChange
from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker, contiguous_runs
from stream.defects.outliers import is_motion, isolated_at, piled_share
from stream.defects.repeats import repeated_share
from stream.estimators.base import NoEstimate
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import BAND_SUM, Spectrum, WelchAverage, welch_edf

SHORT_GAP = 3  # samples that are bridged by a straight line
_BLOCKS = 16  # of a segment
_STEADY = 0.95  # share of the degrees of freedom from which on noise is steady


def runs_of(batches: Iterable[SampleBatch], tracker: GridTracker) -> Iterator[tuple[int, FloatArray]]:
    """Stretches of a signal on the slots of its grid: the first slot and the values, NaN where missing."""
    for batch in batches:
        if pieces := tracker.place(batch):
            yield from contiguous_runs(batch, pieces)


class Preparation:
    """Prepares the samples of a record, after a first pass over all of them.

    Isolated outliers (nine standard deviations from the mean of their neighbours) are missing samples. Gaps of up to
    3 samples are bridged by a straight line where `is_bridged`; longer ones stay. `slow` is subtracted.
    """

    def __init__(self, segment_samples: int, samples: int) -> None:
        # pieces of the spline that end with the record, if it has no gap: a short last one is hardly held
        self.slow = SlowChange(-(-samples // max(1, samples // segment_samples)))
        self.is_bridged = True
        self.outliers, self.largest_outlier = 0, 0.0
        self.short_gaps = 0  # missing samples in gaps of up to 3, outliers included
        self.repeated = 0.0
        self.piled, self.piled_at = 0.0, 0.0  # samples at one value or two, and that value
        self.slots = 0
        # density that bridging adds, times the sample interval: mean square error of a value between its neighbours
        self._added = 0.0
        self._next, self._last = 0, np.nan

    def look_through(self, batches: Iterable[SampleBatch]) -> None:
        """Make the first pass: find outliers, gaps and the slow change."""
        tracker = GridTracker()
        repeated = samples = 0.0
        errors, gap_samples = np.zeros(2), np.zeros(2)
        end = 0
        for first_slot, values in runs_of(batches, tracker):
            far = isolated_at(values)
            self.outliers += len(far)
            self.largest_outlier = max(self.largest_outlier, *far.values(), 0.0)
            kept = values.copy()
            kept[list(far)] = np.nan
            self.slow.take(first_slot, kept)
            finite = np.flatnonzero(np.isfinite(kept))
            if not finite.size:
                continue
            gaps = np.diff(np.r_[end - 1, finite + first_slot]) - 1
            gap_samples += (gaps == 1).sum(), gaps[(gaps > 1) & (gaps <= SHORT_GAP)].sum()
            end = first_slot + int(finite[-1]) + 1
            value = kept[finite]
            repeated += repeated_share(value) * value.size
            share, at = piled_share(value) if _may_be_piled(value) else (0.0, 0.0)
            if share > 0.0:
                self.piled, self.piled_at = self.piled + share * value.size, at
            between = value[2:-2] - 0.5 * np.stack([value[1:-3] + value[3:-1], value[:-4] + value[4:]])
            if between.size:
                with np.errstate(over="ignore"):  # values too large to be squared are refused with their density
                    errors += (between**2).mean(axis=1) * value.size
                samples += value.size
        self.short_gaps, self.slots = int(gap_samples.sum()), end
        if is_motion(self.outliers, tracker.samples):
            self.outliers, self.largest_outlier, self.is_bridged = 0, 0.0, False
        self._added = float(gap_samples @ errors) / max(samples * end, 1.0) if self.short_gaps else 0.0
        self.repeated = repeated / max(tracker.samples, 1)
        self.slow.fit(end)

    @property
    def bridged(self) -> int:
        """Samples that are bridged."""
        return self.short_gaps if self.is_bridged else 0

    @property
    def share(self) -> float:
        """Share of the samples that are bridged."""
        return self.bridged / max(self.slots, 1)

    def passed(self, turns: FloatArray) -> FloatArray:
        """What bridging leaves of an amplitude, at frequencies in cycles a slot."""
        return np.asarray(1.0 - self.share * (1.0 - np.cos(2.0 * np.pi * turns)), np.float64)

    def corrected(self, density: FloatArray, turns: FloatArray, scale: float) -> FloatArray:
        """A density without what bridging makes of it, no less than a tenth of it.

        A share p of samples at random that are replaced by the mean of their neighbours, of the mean square error V:

            S'(f) = S(f) (1 - p (1 - cos 2 pi f dt))**2 + 2 dt p V,    `scale` 2 dt.

        V is that of all samples of the record, for gaps of 2 and 3 at twice the distance.
        """
        own = np.maximum(density - scale * self._added, 0.1 * density)
        return np.asarray(own / self.passed(turns) ** 2, np.float64)

    def restart(self) -> None:
        """Begin with the first sample again."""
        self._next, self._last = 0, np.nan

    def apply(self, first_slot: int, values: FloatArray) -> tuple[int, FloatArray]:
        """The next values with the slot of the first one, prepared; a gap at their end comes with those that follow."""
        if self.outliers:
            values = values.copy()
            values[list(isolated_at(values))] = np.nan
        finite = np.flatnonzero(np.isfinite(values))
        if not finite.size:
            return first_slot, values[:0]
        start, values = first_slot + int(finite[0]), values[finite[0] : finite[-1] + 1]
        gap = start - self._next
        if self.is_bridged and 0 < gap <= SHORT_GAP and np.isfinite(self._last):
            start, values = self._next, np.concatenate([np.full(gap, np.nan), values])
            values[:gap] = np.interp(np.arange(gap), [-1.0, gap], [self._last, values[gap]])
        self._next, self._last = start + len(values), float(values[-1])
        if self.is_bridged and np.isnan(values).any():
            values = _bridged(values)
        return start, values - self.slow.at(start, len(values))


def _bridged(values: FloatArray) -> FloatArray:
    """Gaps of up to 3 samples bridged by straight lines; the first and the last value are there."""
    known = np.flatnonzero(np.isfinite(values))
    bridged = np.interp(np.arange(len(values)), known, values[known])
    after = np.flatnonzero(np.diff(known) > SHORT_GAP + 1)
    for left, right in zip(known[after].tolist(), known[after + 1].tolist(), strict=True):
        bridged[left + 1 : right] = np.nan
    return bridged


class PreparedDensity(SpectralDensity):
    """The spectral density of prepared samples, with the mean and the noise of every sixteenth of a segment."""

    def __init__(self, segment_samples: int, confidence: float, preparation: Preparation) -> None:
        super().__init__(segment_samples, confidence)
        self.preparation = preparation
        preparation.restart()
        self._sums: dict[int, FloatArray] = {}  # by block: values, squares of their differences, and how many

    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        start, prepared = self.preparation.apply(first_slot, values)
        if prepared.size:
            super()._take_run(start, prepared)
            self._take_means(start, prepared)

    def _take_means(self, first_slot: int, values: FloatArray) -> None:
        size = self.segment_samples // _BLOCKS
        begins = np.r_[0, np.arange(size - first_slot % size, len(values), size)]
        with np.errstate(over="ignore"):  # values too large to be squared are refused with their density
            squares = np.diff(values, prepend=values[0]) ** 2
        parts = np.stack([values, squares, np.ones(len(values))])
        for begin, sums in zip(begins.tolist(), np.add.reduceat(parts, begins, axis=1).T, strict=True):
            block = (first_slot + begin) // size
            self._sums[block] = self._sums.get(block, np.zeros(3)) + sums

    def _by_segment(self, of: int) -> FloatArray:
        """Means of blocks, a row a segment: 0 of values, 1 of the squares of their differences; NaN where not whole."""
        means = np.full(max(max(self._sums, default=-1) + 1, _BLOCKS), np.nan)
        for block, sums in self._sums.items():
            if sums[2] == self.segment_samples // _BLOCKS:
                means[block] = sums[of] / sums[2]
        return np.lib.stride_tricks.sliding_window_view(means, _BLOCKS)[:: _BLOCKS // 2]

    def noise_share(self) -> float:
        """Share of the degrees of freedom that noise as it was has of those of steady noise.

        Periodograms i and j of noise of the variance v(t) have the covariance (sum w_i w_j v)**2, hence

            edf = 2 (sum_i c_ii)**2 / sum_ij c_ij**2,    c_ij = sum w_i w_j v,

        v from the mean squares of differences in blocks.
        """
        noise = self._by_segment(1)
        whole = np.asarray(np.isfinite(noise).all(axis=1))
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(_BLOCKS) + 0.5) / _BLOCKS)
        half = _BLOCKS // 2
        own = noise[whole] @ window**2
        shared = (noise[:-1, half:] @ (window[half:] * window[:half]))[whole[:-1] & whole[1:]]
        squares = float((own**2).sum() + 2.0 * (shared**2).sum())
        if not 0.0 < squares < np.inf:
            return 1.0
        return _share(2.0 * float(own.sum()) ** 2 / squares / welch_edf(len(own), len(shared)))

    def band_share(self) -> float:
        """Share of the degrees of freedom that a band of bins has under noise as it was of those of steady noise.

        Bins m apart correlate by sum_i abs(sum w_i**2 v exp(-2 pi i m t/N))**2 over that of m = 0: noise of a short
        time by more than under the window alone.
        """
        noise = self._by_segment(1)
        noise = noise[np.isfinite(noise).all(axis=1)]
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(_BLOCKS) + 0.5) / _BLOCKS)
        power = (np.abs(np.fft.rfft(noise * window**2, axis=1)) ** 2).sum(axis=0)
        if not 0.0 < power[0] < np.inf:
            return 1.0
        return _share(BAND_SUM / (1.0 + 2.0 * float((power[1:-1] / power[0]).sum())))

    def _average(self) -> WelchAverage | NoEstimate:
        average = super()._average()
        if isinstance(average, NoEstimate):
            return average
        return msgspec.structs.replace(average, noise_share=self.noise_share())

    @property
    def factor(self) -> float:
        """From the unit of the samples to that of the results."""
        return self._factor

    @property
    def scale(self) -> float:
        """From the mean square of a sample to the one-sided density of such white noise."""
        return 2.0 * self.sample_interval_s * self._factor**2

    def corrected(self, spectrum: Spectrum) -> Spectrum:
        """The spectrum without what bridging makes of it; the relative bounds stay."""
        if not self.preparation.bridged:
            return spectrum
        density = self.preparation.corrected(
            spectrum.density, spectrum.frequency_hz * self.sample_interval_s, self.scale
        )
        ratio = np.divide(density, spectrum.density, out=np.ones_like(density), where=spectrum.density > 0.0)
        return replace(spectrum, density=density, lo=ratio * spectrum.lo, hi=ratio * spectrum.hi)

    def bridging_correction(self) -> float:
        """Largest relative correction for bridged samples, over all bins but the tenth with the least density."""
        spectrum = self.estimate()
        if isinstance(spectrum, NoEstimate) or not (spectrum.density > 0.0).all():
            return 0.0
        return float(np.quantile(np.abs(self.corrected(spectrum).density / spectrum.density - 1.0), 0.9))

    def slow_part(self) -> npt.NDArray[np.float64]:
        """Density that a cubic through each segment has in every bin from 0 on, by its sidelobes under the Hann window.

        What is left of slow changes within segments reaches the lowest bins by it.
        """
        size, blocks = self.segment_samples, _BLOCKS
        segments = self._by_segment(0)
        segments = segments[np.isfinite(segments).all(axis=1)]
        middles = (np.arange(blocks) + 0.5) / blocks - 0.5
        basis, upper = np.linalg.qr(np.vander(middles, 4, increasing=True))
        fine = np.vander((np.arange(size) + 0.5) / size - 0.5, 4, increasing=True) @ np.linalg.inv(upper)
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(size) / size)
        shapes = np.fft.rfft(window[:, np.newaxis] * fine[:, 1:], axis=0)
        parts = segments @ basis[:, 1:]
        power = _mean_power(shapes, parts) if len(parts) else np.zeros(size // 2 + 1)
        return np.asarray(self.scale / (0.375 * size) * power, np.float64)


def _may_be_piled(values: FloatArray) -> bool:
    """Whether one of a hundred values is the greatest, the least, or 0, without a look at each."""
    return any(100 * int((values == at).sum()) >= values.size for at in (values.max(), values.min(), 0.0))


def _share(found: float) -> float:
    """A share, where it is more than the scatter of steady noise."""
    return found if found < _STEADY else 1.0


def _mean_power(shapes: npt.NDArray[np.complex128], parts: FloatArray) -> FloatArray:
    """Mean over segments of the squared sums of shapes times parts."""
    products = parts.T @ parts / len(parts)
    return np.asarray(np.einsum("ki,ij,kj->k", shapes.conj(), products, shapes).real, np.float64)
