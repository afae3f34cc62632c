"""Power spectral density while the samples flow, and the sinusoidal lines in it (P. D. Welch 1967; IEEE 952-2020)."""

import math
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, first_finite
from stream.errors import EstimatorError
from stream.estimators.base import Estimator, NoEstimate
from stream.estimators.confidence import deviation_bounds
from stream.estimators.spectrum.spectral_lines import (
    REACH_BINS,
    SpectralLine,
    Spectrum,
    WelchAverage,
    find_lines,
    welch_edf,
)
from stream.estimators.spectrum.spectral_segments import PAIRS, SEGMENTS, START, SegmentState, append, empty_state, take
from stream.estimators.spectrum.spectral_segments import continuation as continuation_of

FEWEST_SAMPLES = 128
MOST_SAMPLES = 2**20
FIRST_BIN = 2


class SpectralDensity(Estimator[Spectrum]):
    """One-sided power spectral density of one signal by Welch's method, in bounded memory.

    A segment has N = `segment_samples`, a power of two from 128 to 2**20; the bins lie 1/(N dt) apart. `confidence` is
    the level of all bounds.

    Notes
    -----
    Segment j holds the slots j N/2 .. j N/2 + N - 1 of the signal's grid, whatever the batches. Its mean is
    subtracted, then with the Hann window w_i = (1 - cos(2 pi i/N))/2 and X the Fourier transform of w x

        P(k/(N dt)) = 2 dt abs(X_k)**2 / sum w_i**2,

    averaged over segments (Welch 1967). A segment with a missing or NaN slot is left out and counted. Bins 0 and 1
    are not given, as subtracting the mean lowers them by 2/3 and 1/6, nor is the Nyquist bin, which has half the
    degrees of freedom. Bounds are by chi-square with those of `spectral_lines.welch_edf`, for a density that is smooth
    over a bin. Frequencies are on the scale of the nominal sample interval.

    Memory: 12 N bytes, and up to 8 N more in a `continuation`: its first slots complete the segments across the seam
    when the parts are merged.

    Examples
    --------
    >>> from uuid import UUID
    >>> from stream.batch import SampleBatch
    >>> spectral = SpectralDensity(segment_samples=1024)
    >>> spectral.estimate()
    NoEstimate(reason='a segment of 1024 samples without a gap needed, 0 samples seen')
    >>> i = np.arange(20_000)
    >>> values = np.random.default_rng(1).standard_normal(20_000) + 0.2 * np.sin(2.0 * np.pi * 0.123 * i)
    >>> spectral.update(SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/h", values=values))
    >>> spectrum = spectral.estimate()
    >>> spectrum.segments, round(spectrum.edf, 1), spectrum.unit_of_measure
    (38, 72.1, '(deg/h)^2/Hz')
    >>> [(round(line.frequency_hz, 2), round(line.amplitude, 2)) for line in spectral.lines()]
    [(12.3, 0.21)]
    """

    key = "spectral_density"
    has_points = False
    names = MappingProxyType({"en": "Power spectral density", "zh": "功率谱密度"})

    def __init__(self, segment_samples: int = 4096, confidence: float = 0.95) -> None:
        super().__init__()
        if not FEWEST_SAMPLES <= segment_samples <= MOST_SAMPLES or segment_samples & (segment_samples - 1):
            raise EstimatorError(
                f"segments of {segment_samples} samples: a spectrum takes a power of two from {FEWEST_SAMPLES} to "
                f"{MOST_SAMPLES}"
            )
        if not 0.0 < confidence < 1.0:
            raise EstimatorError(f"a confidence of {confidence}: it lies between 0 and 1")
        self.segment_samples, self.confidence = segment_samples, confidence
        self._state: SegmentState = empty_state(segment_samples)

    @property
    def arguments(self) -> dict[str, int | float]:
        """Samples of a segment, and the confidence level."""
        return {"segment_samples": self.segment_samples, "confidence": self.confidence}

    @property
    def segments(self) -> int:
        """Segments averaged."""
        return int(self._state.places[SEGMENTS])

    @property
    def segments_left_out(self) -> int:
        """Segments up to the last sample that are not averaged because one of their slots holds no finite value."""
        if self.tracker.irregular:
            return 0
        half = self.segment_samples // 2
        ended = (self.tracker.next_slot - self.segment_samples) // half + 1
        first = -(-int(self._state.places[START]) // half)
        return max(0, ended - first) - self.segments

    @property
    def bin_width_hz(self) -> float:
        """Distance of neighbouring bins, Hz; from the first batch on."""
        return 1.0 / (self.segment_samples * self.sample_interval_s)

    @property
    def searched_hz(self) -> tuple[float, float]:
        """Frequency range searched by `lines`, Hz: the bins that have neighbours on both sides."""
        last = self.segment_samples // 2 - 1 - REACH_BINS
        return (FIRST_BIN + REACH_BINS) * self.bin_width_hz, last * self.bin_width_hz

    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        if self.tracker.irregular:
            return
        if math.isnan(self._reference):
            self._reference = first_finite(values)
        take(self._state, first_slot, values, self._reference)

    def _continue_from(self, earlier: Self) -> None:
        self._state = continuation_of(earlier._state)

    def _append(self, later: Self) -> None:
        append(self._state, later._state)

    def _room_for(self, arrays: tuple[npt.NDArray[Any], ...]) -> tuple[npt.NDArray[Any], ...]:
        # only a continuation has a head
        if len(arrays) == len(self._state) and arrays[-1].size < self.segment_samples:
            return self._state._replace(head=np.empty(arrays[-1].size))
        return self._state

    def estimate(self) -> Spectrum | NoEstimate:
        """The density of every bin with its bounds."""
        average = self._average()
        if isinstance(average, NoEstimate):
            return average
        lo, hi = deviation_bounds(1.0, average.edf, self.confidence)
        used = slice(FIRST_BIN, -1)
        density = average.density[used]
        bins = np.arange(FIRST_BIN, self.segment_samples // 2, dtype=np.float64)
        return Spectrum(
            frequency_hz=np.asarray(bins * average.bin_width_hz, np.float64), density=density, lo=density * lo**2,
            hi=density * hi**2, unit_of_measure=f"({self.unit_of_measure})^2/Hz", confidence=self.confidence,
            edf=average.edf, segments=self.segments,
        )  # fmt: skip

    def lines(self, false_alarm_probability: float = 0.01) -> tuple[SpectralLine, ...] | NoEstimate:
        """Sinusoids above the smooth background, lowest frequency first; none is an empty tuple.

        A spectrum without any line shows one with at most the false-alarm probability, over all its bins.

        `spectral_lines.find_lines` describes the test and the intervals. Searched are the bins from 30 to N/2 - 29,
        which have neighbours on both sides; a longer segment reaches lower. A line is assumed to keep its frequency
        and amplitude; one that wanders over bins appears broader and weaker.
        """
        if not 0.0 < false_alarm_probability < 1.0:
            raise EstimatorError(f"a false-alarm probability of {false_alarm_probability}: it lies between 0 and 1")
        average = self._average()
        if isinstance(average, NoEstimate):
            return average
        return find_lines(average, false_alarm_probability, self.confidence)

    def _average(self) -> WelchAverage | NoEstimate:
        if self.tracker.irregular:
            return self._no_grid("power spectral density")
        if self.segments == 0:
            missing = f", {self.missing} missing" if self.missing else ""
            return NoEstimate(
                f"a segment of {self.segment_samples} samples without a gap needed, {self.samples} samples seen"
                f"{missing}"
            )
        # sum of the squares of the Hann window: 3 N/8
        scale = 2.0 * self.sample_interval_s * self._factor**2 / (0.375 * self.segment_samples * self.segments)
        pairs = int(self._state.places[PAIRS])
        _, widest = deviation_bounds(1.0, welch_edf(self.segments, pairs), self.confidence)
        with np.errstate(over="ignore", invalid="ignore"):
            density = scale * self._state.power
            is_finite = bool(np.isfinite(density.sum() * widest**2))
        if not is_finite:
            return self._too_large()
        return WelchAverage(
            density=density, first_bin=FIRST_BIN, bin_width_hz=self.bin_width_hz, segments=self.segments, pairs=pairs
        )
