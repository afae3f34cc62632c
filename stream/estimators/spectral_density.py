"""Power spectral density while the samples flow, and the sinusoidal lines in it (P. D. Welch 1967; IEEE 952-2020)."""

import math
from types import MappingProxyType

import numpy as np
import scipy.fft

from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate, contiguous_runs, first_finite
from stream.estimators.confidence import deviation_limits
from stream.estimators.spectral_lines import Line, Spectrum, WelchAverage, find_lines, hann_window
from stream.quantities import report_unit

FEWEST_SAMPLES = 128
MOST_SAMPLES = 2**20
FIRST_BIN = 2


class SpectralDensity:
    """One-sided power spectral density of one signal by Welch's method, in bounded memory.

    Not an `Estimator`: that yields points over an averaging time, and every one in the package is given to every
    signal. It is fed, asked and refuses in the same manner.

    Parameters
    ----------
    segment_samples : int
        Samples N of a segment, a power of two from 128 to 2**20. The bins lie 1/(N dt) apart.
    confidence : float
        Confidence level of all limits.

    Raises
    ------
    EstimatorError
        If a parameter is outside its range.

    Notes
    -----
    Segment j holds the slots j N/2 .. j N/2 + N - 1 of the signal's grid, whatever the batches. Its mean is taken
    off, then with the Hann window w_i = (1 - cos(2 pi i/N))/2 and X the Fourier transform of w x

        P(k/(N dt)) = 2 dt abs(X_k)**2 / sum w_i**2,

    averaged over segments (Welch 1967). A segment with a missing or NaN slot is left out and counted. Bins 0 and 1
    are not given, as taking off the mean lowers them by 2/3 and 1/6, nor is the Nyquist bin, which has half the
    degrees of freedom. Limits are by chi-square with those of `spectral_lines.welch_edf`, for a density that is smooth
    over a bin. Frequencies are on the scale of the nominal sample interval.

    Memory: 12 N bytes.

    Examples
    --------
    >>> from uuid import UUID
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
    names = MappingProxyType({"en": "Power spectral density", "zh": "功率谱密度"})

    def __init__(self, segment_samples: int = 4096, confidence: float = 0.95) -> None:
        if not FEWEST_SAMPLES <= segment_samples <= MOST_SAMPLES or segment_samples & (segment_samples - 1):
            raise EstimatorError(
                f"segments of {segment_samples} samples: a spectrum takes a power of two from {FEWEST_SAMPLES} to "
                f"{MOST_SAMPLES}"
            )
        if not 0.0 < confidence < 1.0:
            raise EstimatorError(f"a confidence of {confidence}: it lies between 0 and 1")
        self.segment_samples = segment_samples
        self.confidence = confidence
        self._tracker = GridTracker()
        self._signal = ("", "", "")
        self._report_unit = ""
        self._factor = 1.0
        self._reference = math.nan
        self._buffer = np.full(segment_samples, np.nan)
        self._origin = 0
        self._filled = 0
        self._power = np.zeros(segment_samples // 2 + 1)
        self._segments = 0
        self._pairs = 0
        self._last_origin = -segment_samples

    @property
    def unit_of_measure(self) -> str:
        """Unit that amplitudes are reported in, deg/h for angular rates; empty before the first batch."""
        return self._report_unit

    @property
    def samples(self) -> int:
        """Samples with a finite value that were taken in."""
        return self._tracker.samples

    @property
    def missing(self) -> int:
        """Slots of the grid up to the last sample that hold no finite value."""
        return self._tracker.missing

    @property
    def late(self) -> int:
        """Samples left out because their time was not after that of one already taken in."""
        return self._tracker.late

    @property
    def sample_interval_s(self) -> float:
        """Nominal sample interval in seconds, 0 before the first batch."""
        return self._tracker.sample_interval_s

    @property
    def segments(self) -> int:
        """Segments averaged."""
        return self._segments

    @property
    def segments_left_out(self) -> int:
        """Segments up to the last sample that are not averaged as a slot of theirs holds no finite value."""
        beyond = self._tracker.next_slot - self.segment_samples
        if beyond < 0 or self._tracker.irregular:
            return 0
        return beyond // (self.segment_samples // 2) + 1 - self._segments

    @property
    def state_bytes(self) -> int:
        """Size of what is kept of the signal, bytes."""
        return self._buffer.nbytes + self._power.nbytes

    def update(self, batch: SampleBatch) -> None:
        """Take in the next batch of the signal.

        Raises
        ------
        EstimatorError
            If the batch is of another signal, unit of measure or sample interval than those before it.
        """
        signal = (batch.unit, batch.signal, batch.unit_of_measure)
        if signal != self._signal:
            self._begin(batch, signal)
        pieces = self._tracker.place(batch)
        if not pieces or self._tracker.irregular:
            return
        for first_slot, values in contiguous_runs(batch, pieces):
            if math.isnan(self._reference):
                self._reference = first_finite(values)
            with np.errstate(over="ignore", invalid="ignore"):
                self._take(first_slot, values - self._reference)

    def estimate(self) -> Spectrum | NoEstimate:
        """The density of every bin with its limits."""
        average = self._average()
        if isinstance(average, NoEstimate):
            return average
        lo, hi = deviation_limits(1.0, average.edf, self.confidence)
        used = slice(FIRST_BIN, -1)
        density = average.density[used]
        bins = np.arange(FIRST_BIN, self.segment_samples // 2, dtype=np.float64)
        return Spectrum(
            frequency_hz=np.asarray(bins * average.bin_width_hz, np.float64),
            density=density,
            lo=density * lo**2,
            hi=density * hi**2,
            unit_of_measure=f"({self._report_unit})^2/Hz",
            confidence=self.confidence,
            edf=average.edf,
            segments=self._segments,
        )

    def lines(self, false_alarm_probability: float = 0.01) -> tuple[Line, ...] | NoEstimate:
        """Sinusoids above the smooth background, lowest frequency first; none is an empty tuple.

        Parameters
        ----------
        false_alarm_probability : float
            Most probability that a spectrum without any line shows one, over all its bins.

        Raises
        ------
        EstimatorError
            If the probability is not between 0 and 1.

        Notes
        -----
        `spectral_lines.find_lines` has the test, and its fit the intervals. Searched are the bins from 30 to N/2 - 29,
        which have neighbours on both sides; a longer segment reaches lower. A line is taken to keep its frequency
        and amplitude; one that wanders over bins shows as broader and weaker.
        """
        if not 0.0 < false_alarm_probability < 1.0:
            raise EstimatorError(f"a false-alarm probability of {false_alarm_probability}: it lies between 0 and 1")
        average = self._average()
        if isinstance(average, NoEstimate):
            return average
        return find_lines(average, false_alarm_probability, self.confidence)

    def _begin(self, batch: SampleBatch, signal: tuple[str, str, str]) -> None:
        if self._report_unit:
            raise EstimatorError(
                f"run {batch.run}: the {self.names['en']} of unit {self._signal[0]}, signal {self._signal[1]} in "
                f"{self._signal[2]} was given a batch of unit {batch.unit}, signal {batch.signal} in "
                f"{batch.unit_of_measure}; each signal needs one of its own"
            )
        self._signal = signal
        self._report_unit, self._factor = report_unit(batch.unit_of_measure)

    def _take(self, first_slot: int, values: FloatArray) -> None:
        size, half = self.segment_samples, self.segment_samples // 2
        taken = 0
        while taken < len(values):
            start = self._leap(first_slot + taken)
            count = min(size - start, len(values) - taken)
            self._buffer[self._filled : start] = np.nan
            self._buffer[start : start + count] = values[taken : taken + count]
            self._filled = start + count
            taken += count
            if self._filled == size:
                self._close()
                self._buffer[:half] = self._buffer[half:]
                self._origin += half
                self._filled = half

    def _leap(self, slot: int) -> int:
        """Leave the segments behind that end before `slot`; its place in the one that is then being filled."""
        size, half = self.segment_samples, self.segment_samples // 2
        beyond = slot - self._origin - size
        if beyond >= 0:
            self._buffer[self._filled :] = np.nan
            self._buffer[:half] = self._buffer[half:]
            steps = beyond // half + 1
            self._filled = half if steps == 1 else 0
            self._origin += steps * half
        return slot - self._origin

    def _close(self) -> None:
        if not np.isfinite(self._buffer).all():
            return
        transform = scipy.fft.rfft((self._buffer - self._buffer.mean()) * hann_window(self.segment_samples))
        self._power += np.square(transform.real) + np.square(transform.imag)
        self._segments += 1
        self._pairs += self._last_origin == self._origin - self.segment_samples // 2
        self._last_origin = self._origin

    def _average(self) -> WelchAverage | NoEstimate:
        unit, signal, _ = self._signal
        if self._tracker.irregular:
            return NoEstimate(
                f"unit {unit}, signal {signal}: the samples lie on no grid of {self.sample_interval_s:g} s, and the "
                "power spectral density needs one; resample by block means, --resample SECONDS"
            )
        if self._segments == 0:
            missing = f", {self.missing} missing" if self.missing else ""
            return NoEstimate(
                f"a segment of {self.segment_samples} samples without a gap needed, {self.samples} samples seen"
                f"{missing}"
            )
        # sum of the squares of the Hann window: 3 N/8
        scale = 2.0 * self.sample_interval_s * self._factor**2 / (0.375 * self.segment_samples * self._segments)
        with np.errstate(over="ignore", invalid="ignore"):
            density = scale * self._power
            is_finite = bool(np.isfinite(density.sum()))
        if not is_finite:
            return NoEstimate(f"unit {unit}, signal {signal}: values too large to be squared; check the source")
        bin_width_hz = 1.0 / (self.segment_samples * self.sample_interval_s)
        return WelchAverage(
            density=density,
            first_bin=FIRST_BIN,
            bin_width_hz=bin_width_hz,
            segments=self._segments,
            pairs=self._pairs,
        )
