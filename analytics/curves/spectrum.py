"""The power spectral density of a recorded signal, its sinusoidal lines and its broad humps."""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import msgspec
import numpy as np
import scipy.special
from numpy.typing import NDArray

from analytics.curves.baseband import Baseband
from analytics.curves.hump_search import first_clear, search_humps
from analytics.curves.humps import Hump, independent_bins
from analytics.curves.prepared_samples import Preparation, PreparedDensity, runs_of
from analytics.curves.spectrum_remarks import remarks_on
from analytics.curves.steady_lines import BLOCKS_A_SEGMENT, RecordedLine, judge_lines
from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, find_signal, read_signal
from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker
from stream.defects.stillness import Stillness
from stream.errors import BadInput, NotEnoughData
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import deviation_bounds
from stream.estimators.spectral_density import FEWEST_SAMPLES, FIRST_BIN
from stream.estimators.spectrum.spectral_lines import SpectralLine, Spectrum, background_edf, hann_response

CONFIDENCE = 0.95
FALSE_ALARM_PROBABILITY = 0.01
LONGEST_SEGMENT = 65_536

_ENOUGH_SEGMENTS = 8
_SHORT_SEGMENT = 512
_MOST_BRIDGED = 0.15  # relative change of the density by bridging short gaps, for which it is corrected


class Level(msgspec.Struct, frozen=True):
    """Mean density of a band without its lines, with bounds; `frequency_hz` is the geometric mean of its bins."""

    frequency_hz: float
    psd: float
    lo: float
    hi: float


@dataclass(frozen=True)
class SignalSpectrum:
    """One-sided power spectral density of one signal of one run, with its lines and humps."""

    unit: str
    signal: str
    run: str
    unit_of_measure: str  # of the amplitudes of lines; ``deg/h`` for angular rates
    sample_interval_s: float
    samples: int
    missing: int
    frequency_hz: tuple[float, ...]  # frequency of every bin, increasing in equal steps
    psd: tuple[float, ...]  # density of every bin, in `psd_unit`, with its confidence bounds
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    psd_unit: str  # ``(deg/h)^2/Hz`` for angular rates
    confidence: float
    edf: float  # equivalent degrees of freedom of a bin
    segments: int
    segments_left_out: int  # for missing samples
    segment_samples: int
    bin_width_hz: float
    false_alarm_probability: float  # largest probability that a spectrum without any line shows one; the same for humps
    searched_lo_hz: float  # band that was searched for lines: bins with neighbours on both sides
    searched_hi_hz: float
    lines: tuple[RecordedLine, ...]  # lowest frequency first, as the humps
    humps: tuple[Hump, ...] = ()
    longest_still: int = 0  # samples of the longest stretch in which all are alike
    narrow_hz: tuple[float, ...] = ()  # peaks as narrow as lines beyond the band that is searched for these
    humps_lo_hz: float = 0.0  # from where on humps are looked for: slow changes reach lower bins
    slow_span: float = 0.0  # between the ends of the slow change that is subtracted, in `unit_of_measure`; 0 if none is
    slow_below_hz: float = 0.0  # slower than which changes are subtracted
    outliers: int = 0  # left out, and the largest in standard deviations
    largest_outlier: float = 0.0
    bridged: int = 0  # missing samples in short gaps, and by how much the density is corrected for bridging them
    bridging_correction: float = 0.0
    repeated: float = 0.0  # least share of samples that repeat the one before
    piled: int = 0  # samples at one value or two, and that value
    piled_at: float = 0.0
    noise_share: float = 1.0  # of the degrees of freedom of steady noise, that the record has
    band_edf: float = math.inf  # degrees of freedom of a bin among others of a band, where fewer than `edf`

    def __post_init__(self) -> None:
        """Check that the columns fit together."""
        if len({len(column) for column in (self.frequency_hz, self.psd, self.lo, self.hi)}) != 1:
            raise BadInput(f"spectrum of unit {self.unit}, run {self.run}: its columns differ in length")

    @property
    def remarks(self) -> list[tuple[str, str]]:
        """What a reader must know of the record, in English and Chinese."""
        return remarks_on(self)

    def document(self) -> dict[str, Any]:
        """Return the spectrum as it stands in JSON."""
        names = {"amplitude_lo": "lo", "amplitude_hi": "hi"}
        unit = {"unit_of_measure": self.unit_of_measure}
        lines = [
            {names.get(k, k): None if v != v else v for k, v in msgspec.structs.asdict(line).items()} | unit
            for line in self.lines
        ]
        humps = [msgspec.structs.asdict(hump) | unit for hump in self.humps]
        remarks = [{"en": english, "zh": chinese} for english, chinese in self.remarks]
        return asdict(self) | {"lines": lines, "humps": humps, "remarks": remarks}

    def levels(self, edges_hz: FloatArray) -> list[Level]:
        """Mean density of the bands between neighbouring edges (Hz); bands without a bin are left out.

        Bins that a line or its sidelobes reach do not count, at least 4 on either side. Bounds are for a density that
        is smooth over a band: m bins of `edf` degrees, whose densities correlate by 4/9 and 1/36 one and two bins
        apart, have m edf / (1 + 8/9 (1 - 1/m) + 1/18 (1 - 2/m)) together.
        """
        frequency_hz, psd = np.array(self.frequency_hz), np.array(self.psd)
        clear = _clear_of(self.lines, frequency_hz)
        bands = np.searchsorted(frequency_hz, edges_hz).tolist()
        found = []
        for start, stop in itertools.pairwise(bands):
            kept = np.flatnonzero(clear[start:stop]) + start
            if len(kept) == 0:
                continue
            value = float(psd[kept].mean())
            lo, hi = deviation_bounds(1.0, min(self.edf, self.band_edf) * independent_bins(len(kept)), self.confidence)
            middle_hz = float(np.exp(np.log(frequency_hz[kept]).mean()))
            found.append(Level(middle_hz, value, value * lo**2, value * hi**2))
        return found

    def least_amplitude(self, level: Level) -> float | None:
        """Amplitude from which a line over this background is found in at least half of the spectra.

        None outside the band that was searched. Taken half way between two bins, where a line is hardest to see.
        """
        if not self.searched_lo_hz <= level.frequency_hz <= self.searched_hi_hz:
            return None
        bins = round((self.searched_hi_hz - self.searched_lo_hz) / self.bin_width_hz) + 1
        chance = self.false_alarm_probability / bins
        ratio = 1.0 / float(scipy.special.fdtri(background_edf(self.edf), self.edf, chance))
        response = float(hann_response(np.array([0.5]))[0])
        return math.sqrt(0.75 * (ratio - 1.0) * level.psd * self.bin_width_hz) / response


def spectrum_of(catalog: Catalog, unit: str, signal: str, run: str | None = None) -> SignalSpectrum:
    """Power spectral density of a signal in the store, with its lines; without a run it is of the longest record."""
    record = find_signal(catalog, unit, signal, run)
    if record.irregular:
        raise NotEnoughData(
            f"unit {unit}, signal {signal}, run {record.run}: no power spectral density: the samples are irregular, "
            "and it needs equal intervals; gyrofleet allan --resample SECONDS takes such samples, a spectrum needs "
            "the signal recorded or imported at equal intervals"
        )
    return spectrum_from(record, lambda: read_signal(catalog, record))


def spectrum_from(
    record: SignalRecord, read: Callable[[], Iterable[SampleBatch]], segment_samples: int | None = None
) -> SignalSpectrum:
    """The spectrum of a record that is read again and again.

    Segments are as long as 8 of them allow, from 512 to 65,536 samples: long ones resolve lines and reach low
    frequencies, and their mean has 16 degrees of freedom or more. A record that gaps cut into pieces shorter than that
    is read again with segments half as long, until 8 are whole. Short gaps are bridged (`Preparation`) unless that
    would change the density by more than 15 %.
    """
    size = segment_samples or segment_for(record.samples)
    still, preparation = Stillness(), Preparation(size, record.samples)
    preparation.look_through(still.watched(read()))
    spectral = _fed(read, preparation, size)
    if spectral.bridging_correction() > _MOST_BRIDGED:
        preparation.is_bridged = False
        spectral = _fed(read, preparation, size)
    return _result(record, spectral, read, still.longest)


def segment_for(samples: int) -> int:
    """Samples of a segment for a record of so many without a gap: a power of two."""
    averaged = 2 * samples // (_ENOUGH_SEGMENTS + 1)
    longest = max(averaged, min(samples, _SHORT_SEGMENT), FEWEST_SAMPLES)
    return min(LONGEST_SEGMENT, 1 << (longest.bit_length() - 1))


def _fed(read: Callable[[], Iterable[SampleBatch]], preparation: Preparation, size: int) -> PreparedDensity:
    while True:
        spectral = PreparedDensity(size, CONFIDENCE, preparation)
        for batch in read():
            spectral.update(batch)
        shortest = _SHORT_SEGMENT if spectral.segments else FEWEST_SAMPLES
        if spectral.segments >= _ENOUGH_SEGMENTS or size <= shortest:
            return spectral
        size //= 2


def _lines(
    spectral: PreparedDensity, spectrum: Spectrum, lines: tuple[SpectralLine, ...],
    read: Callable[[], Iterable[SampleBatch]],
) -> tuple[RecordedLine, ...]:  # fmt: skip
    """The lines, judged by a further look at the record."""
    if not lines:
        return ()
    interval_s, preparation = spectral.sample_interval_s, spectral.preparation
    frequencies = [line.frequency_hz * interval_s for line in lines]
    base = Baseband(frequencies, spectral.segment_samples // BLOCKS_A_SEGMENT)
    preparation.restart()
    for first_slot, values in runs_of(read(), GridTracker()):
        base.take(*preparation.apply(first_slot, values))
    judged = judge_lines(lines, spectrum, base, spectral.scale)
    passed = preparation.passed(np.array([line.frequency_hz * interval_s for line in judged]))
    names = ("amplitude", "amplitude_lo", "amplitude_hi")
    return tuple(
        msgspec.structs.replace(line, **{name: getattr(line, name) / part for name in names})
        for line, part in zip(judged, passed.tolist(), strict=True)
    )


def _result(
    record: SignalRecord, spectral: PreparedDensity, read: Callable[[], Iterable[SampleBatch]], longest_still: int = 0
) -> SignalSpectrum:
    spectrum, lines = spectral.estimate(), spectral.lines(FALSE_ALARM_PROBABILITY)
    if isinstance(spectrum, NoEstimate) or isinstance(lines, NoEstimate):
        refused = spectrum if isinstance(spectrum, NoEstimate) else lines
        assert isinstance(refused, NoEstimate)
        where = f"unit {record.unit}, signal {record.signal}"
        reason = refused.reason.removeprefix(f"{where}: ")
        raise NotEnoughData(f"{where}, run {record.run}: no power spectral density: {reason}")
    lo_hz, hi_hz = spectral.searched_hz
    judged, preparation = _lines(spectral, spectrum, lines, read), spectral.preparation
    spectrum = spectral.corrected(spectrum)
    clear = _clear_of(judged, spectrum.frequency_hz)
    first = first_clear(spectral.slow_part(), spectrum)
    clear[:first] = False
    band_edf = spectrum.edf * spectral.band_share()
    humps, narrow_hz = search_humps(
        spectrum, clear, (lo_hz, hi_hz), band_edf=band_edf, sample_interval_s=spectral.sample_interval_s,
        false_alarm_probability=FALSE_ALARM_PROBABILITY,
    )  # fmt: skip
    return SignalSpectrum(
        unit=record.unit, signal=record.signal, run=record.run, unit_of_measure=spectral.unit_of_measure,
        sample_interval_s=spectral.sample_interval_s, samples=spectral.samples, missing=spectral.missing,
        frequency_hz=tuple(spectrum.frequency_hz.tolist()), psd=tuple(spectrum.density.tolist()),
        lo=tuple(spectrum.lo.tolist()), hi=tuple(spectrum.hi.tolist()), psd_unit=spectrum.unit_of_measure,
        confidence=spectrum.confidence, edf=spectrum.edf, segments=spectrum.segments,
        segments_left_out=spectral.segments_left_out, segment_samples=spectral.segment_samples,
        bin_width_hz=spectral.bin_width_hz, false_alarm_probability=FALSE_ALARM_PROBABILITY, searched_lo_hz=lo_hz,
        searched_hi_hz=hi_hz, lines=judged, humps=humps, longest_still=longest_still, narrow_hz=narrow_hz,
        humps_lo_hz=(FIRST_BIN + first) * spectral.bin_width_hz, slow_span=preparation.slow.span * spectral.factor,
        slow_below_hz=0.5 / (preparation.slow.spacing * spectral.sample_interval_s), outliers=preparation.outliers,
        largest_outlier=preparation.largest_outlier, bridged=preparation.bridged,
        bridging_correction=spectral.bridging_correction(), repeated=preparation.repeated,
        piled=round(preparation.piled), piled_at=preparation.piled_at * spectral.factor,
        noise_share=spectral.noise_share(), band_edf=band_edf,
    )  # fmt: skip


def _clear_of(lines: Iterable[RecordedLine], frequency_hz: FloatArray) -> NDArray[np.bool_]:
    """Bins that no line or sidelobe reaches."""
    clear = np.ones(frequency_hz.size, np.bool_)
    step_hz = float(frequency_hz[1] - frequency_hz[0])
    for line in lines:
        low, high = line.reach_lo_hz - 0.5 * step_hz, line.reach_hi_hz + 0.5 * step_hz
        clear &= (frequency_hz < low) | (frequency_hz > high)
    return clear


def with_error(value: float, half_width: float, digits: int = 2) -> str:
    """A value and its half width to so many digits of the latter.

    >>> with_error(12.345678, 0.00123), with_error(50.0, 12.0), with_error(3.0, 0.0)
    ('12.3457 ± 0.0012', '50 ± 12', '3 ± 0')
    """
    if half_width <= 0.0:
        return f"{value:g} ± 0"
    decimals = max(0, digits - 1 - math.floor(math.log10(half_width)))
    return f"{value:.{decimals}f} ± {half_width:.{decimals}f}"
