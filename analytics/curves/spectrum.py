"""The power spectral density of a recorded signal, its sinusoidal lines and its broad humps."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import msgspec
import numpy as np
import scipy.special
from numpy.typing import NDArray

from analytics.curves.humps import Hump, find_humps, independent_bins
from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, find_signal, read_signal
from stream.batch import FloatArray
from stream.defects.stillness import Stillness, remark_on_stillness
from stream.errors import BadInput, NotEnoughData
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import deviation_bounds
from stream.estimators.spectral_density import FEWEST_SAMPLES, FIRST_BIN, SpectralDensity
from stream.estimators.spectrum.spectral_lines import GUARD_BINS, SpectralLine, background_edf, hann_response

CONFIDENCE = 0.95
FALSE_ALARM_PROBABILITY = 0.01
LONGEST_SEGMENT = 65_536

_ENOUGH_SEGMENTS = 8
_SHORT_SEGMENT = 512


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
    lines: tuple[SpectralLine, ...]  # lowest frequency first, as the humps
    humps: tuple[Hump, ...] = ()
    longest_still: int = 0  # samples of the longest stretch in which all are alike

    def __post_init__(self) -> None:
        """Check that the columns fit together."""
        if len({len(column) for column in (self.frequency_hz, self.psd, self.lo, self.hi)}) != 1:
            raise BadInput(f"spectrum of unit {self.unit}, run {self.run}: its columns differ in length")

    @property
    def remark(self) -> tuple[str, str] | None:
        """What a reader must know of the record, in English and Chinese."""
        return remark_on_stillness(self.longest_still, self.samples)

    def document(self) -> dict[str, Any]:
        """Return the spectrum as it stands in JSON."""
        names = {"amplitude_lo": "lo", "amplitude_hi": "hi"}
        unit = {"unit_of_measure": self.unit_of_measure}
        lines = [{names.get(k, k): v for k, v in msgspec.structs.asdict(line).items()} | unit for line in self.lines]
        return asdict(self) | {"lines": lines, "humps": [msgspec.structs.asdict(hump) | unit for hump in self.humps]}

    def levels(self, edges_hz: FloatArray) -> list[Level]:
        """Mean density of the bands between neighbouring edges (Hz); bands without a bin are left out.

        Bins within 4 of a line do not count. Bounds are for a density that is smooth over a band: m bins of `edf`
        degrees, whose densities correlate by 4/9 and 1/36 one and two bins apart, have m edf / (1 + 8/9 (1 - 1/m) +
        1/18 (1 - 2/m)) together.
        """
        frequency_hz, psd = np.array(self.frequency_hz), np.array(self.psd)
        clear = _clear_of(self.lines, len(psd), self.bin_width_hz)
        bands = np.searchsorted(frequency_hz, edges_hz).tolist()
        found = []
        for start, stop in itertools.pairwise(bands):
            kept = np.flatnonzero(clear[start:stop]) + start
            if len(kept) == 0:
                continue
            value = float(psd[kept].mean())
            lo, hi = deviation_bounds(1.0, self.edf * independent_bins(len(kept)), self.confidence)
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
    """Power spectral density of a signal in the store, with its lines.

    Without a run it is of the longest record. Segments are as long as 8 of them allow, from 512 to 65,536 samples: long
    ones resolve lines and reach low frequencies, and their mean has 16 degrees of freedom or more. A record that gaps
    cut into pieces shorter than that is read again with segments half as long, until 8 are whole.
    """
    record = find_signal(catalog, unit, signal, run)
    if record.irregular:
        raise NotEnoughData(
            f"unit {unit}, signal {signal}, run {record.run}: no power spectral density: the samples are irregular, "
            "and it needs equal intervals; gyrofleet allan --resample SECONDS takes such samples, a spectrum needs "
            "the signal recorded or imported at equal intervals"
        )
    size = segment_for(record.samples)
    spectral, still = _fed(catalog, record, size)
    while spectral.segments < _ENOUGH_SEGMENTS and size > (_SHORT_SEGMENT if spectral.segments else FEWEST_SAMPLES):
        size //= 2
        spectral, still = _fed(catalog, record, size)
    return _result(record, spectral, still.longest)


def segment_for(samples: int) -> int:
    """Samples of a segment for a record of so many without a gap: a power of two."""
    averaged = 2 * samples // (_ENOUGH_SEGMENTS + 1)
    longest = max(averaged, min(samples, _SHORT_SEGMENT), FEWEST_SAMPLES)
    return min(LONGEST_SEGMENT, 1 << (longest.bit_length() - 1))


def _fed(catalog: Catalog, record: SignalRecord, segment_samples: int) -> tuple[SpectralDensity, Stillness]:
    spectral, still = SpectralDensity(segment_samples, CONFIDENCE), Stillness()
    for batch in still.watched(read_signal(catalog, record)):
        spectral.update(batch)
    return spectral, still


def _result(record: SignalRecord, spectral: SpectralDensity, longest_still: int = 0) -> SignalSpectrum:
    spectrum, lines = spectral.estimate(), spectral.lines(FALSE_ALARM_PROBABILITY)
    if isinstance(spectrum, NoEstimate) or isinstance(lines, NoEstimate):
        refused = spectrum if isinstance(spectrum, NoEstimate) else lines
        assert isinstance(refused, NoEstimate)
        where = f"unit {record.unit}, signal {record.signal}"
        reason = refused.reason.removeprefix(f"{where}: ")
        raise NotEnoughData(f"{where}, run {record.run}: no power spectral density: {reason}")
    lo_hz, hi_hz = spectral.searched_hz
    clear = _clear_of(lines, spectrum.density.size, spectral.bin_width_hz)
    humps = find_humps(
        spectrum.frequency_hz[clear], spectrum.density[clear], spectrum.edf,
        sample_interval_s=spectral.sample_interval_s, false_alarm_probability=FALSE_ALARM_PROBABILITY,
        confidence=CONFIDENCE,
    )  # fmt: skip
    return SignalSpectrum(
        unit=record.unit, signal=record.signal, run=record.run, unit_of_measure=spectral.unit_of_measure,
        sample_interval_s=spectral.sample_interval_s, samples=spectral.samples, missing=spectral.missing,
        frequency_hz=tuple(spectrum.frequency_hz.tolist()), psd=tuple(spectrum.density.tolist()),
        lo=tuple(spectrum.lo.tolist()), hi=tuple(spectrum.hi.tolist()), psd_unit=spectrum.unit_of_measure,
        confidence=spectrum.confidence, edf=spectrum.edf, segments=spectrum.segments,
        segments_left_out=spectral.segments_left_out, segment_samples=spectral.segment_samples,
        bin_width_hz=spectral.bin_width_hz, false_alarm_probability=FALSE_ALARM_PROBABILITY, searched_lo_hz=lo_hz,
        searched_hi_hz=hi_hz, lines=lines, humps=humps, longest_still=longest_still,
    )  # fmt: skip


def _clear_of(lines: Iterable[SpectralLine], bins: int, bin_width_hz: float) -> NDArray[np.bool_]:
    """Bins that are not within 4 of a line."""
    clear = np.ones(bins, np.bool_)
    for line in lines:
        middle = round(line.frequency_hz / bin_width_hz) - FIRST_BIN
        clear[max(0, middle - GUARD_BINS) : middle + GUARD_BINS + 1] = False
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
