"""The spectrum of records as they come: lines that move, warm-up, strong lines, outliers, lost and repeated samples."""

from collections.abc import Callable
from uuid import UUID

import numpy as np
import pytest
from scipy import signal, stats

from analytics.curves.spectrum import SignalSpectrum, spectrum_from
from storage.sql.reading import SignalRecord
from stream.batch import FloatArray, IntArray, SampleBatch

RATE_HZ, N, SIGMA, PIECE = 200.0, 60_000, 30.0, 7_000
T_S = np.arange(N) / RATE_HZ
DENSITY = 2.0 * SIGMA**2 / RATE_HZ


def spectrum(values: FloatArray, kept: IntArray | None = None) -> SignalSpectrum:
    """Of a record that comes in pieces; `kept` are the numbers of the samples that are there."""
    at = np.arange(N) if kept is None else kept
    pieces = [at[i : i + PIECE] for i in range(0, at.size, PIECE)]
    batches = [
        SampleBatch(
            "FOG-1", "rate", "r1", UUID(int=1), int(i * PIECE), int(piece[0]) * 5_000_000, 5_000_000, "deg/h",
            values=values[piece], times_ns=None if kept is None else piece * 5_000_000,
        )
        for i, piece in enumerate(pieces)
    ]  # fmt: skip
    return spectrum_from(SignalRecord("FOG-1", "rate", "r1", "deg/h", at.size, False), lambda: batches)


def noise(rng: np.random.Generator, sigma: float = SIGMA) -> FloatArray:
    return sigma * rng.standard_normal(N)


def steady(_: np.random.Generator) -> FloatArray:
    return 2.0 * np.pi * 50.0 * T_S


def swept(_: np.random.Generator) -> FloatArray:
    return 2.0 * np.pi * (50.0 * T_S + 0.5 * 0.2 / 300.0 * T_S**2)


def wandering(rng: np.random.Generator) -> FloatArray:
    """50 Hz with a standard deviation of 0.02 Hz over 20 s, as of mains."""
    wander = np.convolve(rng.standard_normal(N + 4000), np.full(4000, 4000**-0.5), "valid")[:N]
    return np.asarray(2.0 * np.pi * (50.0 * T_S + np.cumsum(0.02 * wander) / RATE_HZ), np.float64)


def english(found: SignalSpectrum) -> str:
    return " ".join(text for text, _ in found.remarks)


@pytest.mark.parametrize(
    ("phase", "middle_hz", "is_steady"), [(steady, 50.0, True), (wandering, 50.0, False), (swept, 50.1, False)]
)
@pytest.mark.parametrize(("amplitude", "trials"), [(6.0, 6), (60.0, 6), pytest.param(6.0, 60, marks=pytest.mark.long)])
def test_the_limits_of_a_line_hold_it_whether_it_is_steady_or_moves(
    phase: Callable[[np.random.Generator], FloatArray], middle_hz: float, is_steady: bool, amplitude: float, trials: int
) -> None:
    rng = np.random.default_rng(20260117)
    held = np.zeros(2)
    for _ in range(trials):
        found = spectrum(noise(rng) + amplitude * np.sin(phase(rng) + rng.uniform(0.0, 6.28)))
        # a line or a hump elsewhere comes by chance in 1 % of records each
        (line,) = (each for each in found.lines if abs(each.frequency_hz - 50.0) < 1.0)
        assert line.is_steady is is_steady
        assert ("not one steady sinusoid" in english(found)) is not is_steady
        assert not any(hump.frequency_lo_hz < 55.0 and hump.frequency_hi_hz > 45.0 for hump in found.humps)
        assert line.frequency_hi_hz - line.frequency_lo_hz < (0.01 if is_steady else 0.3)
        held += (
            line.amplitude_lo <= amplitude <= line.amplitude_hi,
            line.frequency_lo_hz <= middle_hz <= line.frequency_hi_hz,
        )
    # 95 % of them; fewer than this by chance once in 1000
    assert held.min() >= stats.binom.ppf(0.001, trials, 0.95)


@pytest.mark.parametrize("share", [0.05, 0.6, -1.0], ids=["burst", "switched off", "fading"])
@pytest.mark.parametrize(("amplitude", "trials"), [(60.0, 4), pytest.param(300.0, 40, marks=pytest.mark.long)])
def test_the_limits_of_a_line_that_comes_and_goes_hold_its_mean_power(
    share: float, amplitude: float, trials: int
) -> None:
    rng = np.random.default_rng(20260118)
    held = 0
    for _ in range(trials):
        begin = rng.uniform(0.0, 0.9) if share == 0.05 else 0.0
        place = np.arange(N) / N
        strength = np.exp(-5.0 * place) if share < 0.0 else ((place >= begin) & (place < begin + share)).astype(float)
        found = spectrum(noise(rng) + amplitude * strength * np.sin(2.0 * np.pi * 50.004 * T_S))
        (line,) = (each for each in found.lines if abs(each.frequency_hz - 50.0) < 1.0)
        assert line.is_steady is False
        held += line.amplitude_lo <= amplitude * float((strength**2).mean()) ** 0.5 <= line.amplitude_hi
    assert held >= stats.binom.ppf(0.001, trials, 0.95)


@pytest.mark.parametrize("rise", [300.0, 3000.0])
def test_a_warm_up_or_a_trend_is_no_hump_and_hardly_changes_the_density(rise: float) -> None:
    rng = np.random.default_rng(6)
    for slow in (rise * np.exp(-T_S / 60.0), 20.0 * rise / 300.0 * T_S):
        found = spectrum(noise(rng, 3.0) + slow)
        assert found.humps == ()
        assert found.slow_span == pytest.approx(np.ptp(slow), rel=0.02)
        # 26 degrees of freedom a bin, the eight bins together some 100: within 60 % of the density
        assert np.mean(found.psd[:8]) == pytest.approx(DENSITY / 100.0, rel=0.6)


def test_two_warm_ups_at_once_reach_bins_that_are_named() -> None:
    slow = 2000.0 * np.exp(-T_S / 60.0) + 1000.0 * np.exp(-T_S / 5.0)
    found = spectrum(noise(np.random.default_rng(6), 3.0) + slow)
    assert found.humps == ()
    assert f"below {found.humps_lo_hz:.3g} Hz the density is in part of sidelobes" in english(found)


@pytest.mark.parametrize("amplitude", [300.0, 3000.0, 30_000.0])
def test_the_sidelobes_of_a_strong_line_are_no_hump(amplitude: float) -> None:
    found = spectrum(noise(np.random.default_rng(7)) + amplitude * np.sin(2.0 * np.pi * 33.3333 * T_S))
    (line,) = found.lines
    assert line.is_steady
    assert found.humps == ()
    (level,) = found.levels(np.array([32.0, 35.0]))
    assert level.lo < DENSITY < level.hi


def test_a_line_below_the_band_of_lines_is_no_hump_and_named() -> None:
    found = spectrum(noise(np.random.default_rng(8)) + 3.0 * np.sin(2.0 * np.pi * 0.7 * T_S))
    assert (found.lines, found.humps) == ((), ())
    assert "near 0.7" in english(found)
    assert "lines are searched from 0.7324 to 99.29 Hz" in english(found)


def test_outliers_are_left_out_counted_and_named() -> None:
    values = noise(np.random.default_rng(9)) + 4.0 * np.sin(2.0 * np.pi * 50.0 * T_S)
    clean = spectrum(values)
    for at in ([30_000], [0, 500, 7_000, 13_999, 59_999]):
        struck = values.copy()
        struck[at] = 99_999.0
        found = spectrum(struck)
        assert found.outliers == len(at)
        assert f"isolated outliers are left out: {len(at)}, up to" in english(found)
        assert np.median(found.psd) == pytest.approx(np.median(clean.psd), rel=0.02)
        assert found.lines[0].amplitude == pytest.approx(4.0, rel=0.15)


def test_repeated_samples_are_named() -> None:
    values = noise(np.random.default_rng(10))
    assert "at least 75 % of the samples repeat the one before" in english(spectrum(np.repeat(values[::4], 4)))
    assert english(spectrum(values)) == ""


@pytest.mark.parametrize("lost", [200, 3000])
def test_single_lost_samples_cost_no_segment(lost: int) -> None:
    rng = np.random.default_rng(15)
    amplitude = 12.0
    values = noise(rng) + amplitude * np.sin(2.0 * np.pi * 80.0 * T_S)
    kept = np.ones(N, np.bool_)
    kept[1 + rng.choice(N - 2, lost, replace=False)] = False
    found = spectrum(values, np.flatnonzero(kept))
    assert (found.segments, found.segment_samples) == (13, 8192)
    assert f"bridged by straight lines: {found.bridged:,};" in english(found)
    assert lost - 20 <= found.bridged <= lost
    (line,) = found.lines
    assert line.is_steady
    assert line.amplitude_lo <= amplitude <= line.amplitude_hi
    for low_hz, high_hz in ((1.0, 10.0), (90.0, 99.0)):
        (level,) = found.levels(np.array([low_hz, high_hz]))
        # 26 degrees of freedom a bin, over 190 independent bins or more: a deviation of 2 %, and four of these
        assert level.psd == pytest.approx(DENSITY, rel=0.08)


def test_what_cannot_be_bridged_is_left_out_and_named() -> None:
    rng = np.random.default_rng(12)
    kept = np.ones(N, np.bool_)
    kept[20_000:21_000] = False
    kept[1 + rng.choice(N - 2, 200, replace=False)] = False
    weak = spectrum(noise(rng) + 4.0 * np.sin(2.0 * np.pi * 50.0 * T_S), np.flatnonzero(kept))
    assert (weak.segment_samples, weak.lines[0].is_steady) == (8192, True)
    # a line of 100 times the noise cannot be bridged by straight lines
    strong = spectrum(noise(rng) + 3000.0 * np.sin(2.0 * np.pi * 50.0 * T_S), np.flatnonzero(kept))
    assert strong.bridged == 0
    # a segment of 512 samples is whole in 18 % of cases (0.9967**512), and the gap of 5 s takes 5 of 233
    assert 0.7 < strong.segments_left_out / (strong.segments_left_out + strong.segments) < 0.95
    assert "are left out for missing samples: the spectrum is of the others" in english(strong)
    (line,) = strong.lines
    assert line.amplitude_lo <= 3000.0 <= line.amplitude_hi


@pytest.mark.long
@pytest.mark.parametrize("kind", ["white", "flicker", "walk"])
def test_noise_shows_a_line_or_a_hump_no_more_often_than_promised(kind: str) -> None:
    rng = np.random.default_rng(13)
    records, lines, humps, named = 300, 0, 0, 0
    shape = np.fft.rfftfreq(2 * N, 1.0 / RATE_HZ)
    shape[0] = shape[1]
    for _ in range(records):
        values = noise(rng)
        if kind == "flicker":
            values += 3.0 * np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * N)) / np.sqrt(shape))[:N]
        if kind == "walk":
            values += np.cumsum(0.1 * rng.standard_normal(N))
        found = spectrum(values)
        lines, humps = lines + bool(found.lines), humps + bool(found.humps)
        named += bool(found.remarks)
    # at most 1 % of them; the binomial quantile is passed by chance once in 1000
    most = stats.binom.ppf(0.999, records, 0.01)
    assert max(lines, humps) <= most
    assert named <= most


def burst(_: FloatArray) -> FloatArray:
    """Ten times the noise for a twentieth of the record, as when somebody touches the table."""
    return np.where((T_S > 150.0) & (T_S < 165.0), 10.0, 1.0)


@pytest.mark.parametrize(
    "course", [burst, lambda t: np.where(t > 150.0, 5.0, 1.0), lambda t: np.where(t > 200.0, 1.0, 0.01)]
)
@pytest.mark.parametrize("trials", [3, pytest.param(60, marks=pytest.mark.long)])
def test_noise_that_changes_makes_no_lines_and_no_humps(
    course: Callable[[FloatArray], FloatArray], trials: int
) -> None:
    rng, sigmas = np.random.default_rng(73), course(T_S)
    amplitude = 0.3 * SIGMA * float(np.sqrt((sigmas**2).mean()))
    false, missed = 0, 0
    for _ in range(trials):
        values = noise(rng) * sigmas
        found = spectrum(values)
        false += bool(found.lines) + bool(found.humps)
        assert "is not the same all the time" in english(found)
        of_line = spectrum(values + amplitude * np.sin(2.0 * np.pi * 50.0 * T_S))
        missed += not any(line.amplitude_lo <= amplitude <= line.amplitude_hi for line in of_line.lines)
    # each record may show a false line with 1 % and a false hump with 1 %, and limits miss 5 %
    assert false <= stats.binom.ppf(0.9999, 2 * trials, 0.01)
    assert missed <= stats.binom.ppf(0.9999, trials, 0.05)


@pytest.mark.parametrize("amplitude", [1e4, 1e6])
def test_sidelobes_of_a_very_strong_line_are_no_hump(amplitude: float) -> None:
    rng = np.random.default_rng(74)
    found = spectrum(noise(rng) + SIGMA * amplitude * np.sin(2.0 * np.pi * 24.6912 * T_S))
    assert found.humps == ()
    (line,) = found.lines
    assert line.amplitude_lo <= SIGMA * amplitude <= line.amplitude_hi


@pytest.mark.parametrize("amplitude", [1.0, 30.0])
def test_a_line_at_the_nyquist_frequency_is_a_narrow_peak_and_no_hump(amplitude: float) -> None:
    rng = np.random.default_rng(75)
    found = spectrum(noise(rng) + SIGMA * amplitude * np.where(np.arange(N) % 2, 1.0, -1.0))
    assert (found.lines, found.humps) == ((), ())
    assert "near 100 Hz there is a peak as narrow as a line where none can be tested" in english(found)


def test_a_clipped_output_and_an_output_filter_are_named() -> None:
    rng = np.random.default_rng(76)
    clipped = spectrum(np.clip(noise(rng) + 3.0 * SIGMA * np.sin(2.0 * np.pi * 5.0 * T_S), -2.0 * SIGMA, 2.0 * SIGMA))
    assert "samples are at one value or two" in english(clipped)
    filtered = spectrum(np.asarray(signal.lfilter(*signal.butter(4, 0.3), noise(rng)), np.float64))
    assert "is wider than two octaves" in english(filtered)
    plain = english(spectrum(noise(rng)))
    assert "octaves" not in plain
    assert "one value" not in plain


def flicker(rng: np.random.Generator, n: int) -> FloatArray:
    """Noise of a density of 1/f, without its lowest bins."""
    bins = np.fft.rfft(rng.standard_normal(2 * n))
    return np.asarray(np.fft.irfft(bins / np.sqrt(np.maximum(np.arange(bins.size), 1.0)))[:n], np.float64)


def averaged(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(-1, 10).mean(axis=1), np.float64)


@pytest.mark.parametrize("make", [
    lambda rng: flicker(rng, N), lambda rng: averaged(flicker(rng, 10 * N)),
    lambda rng: averaged(np.cumsum(rng.standard_normal(10 * N))),
])  # fmt: skip
@pytest.mark.parametrize("trials", [3, pytest.param(40, marks=pytest.mark.long)])
def test_flicker_and_averaged_noises_are_no_humps(
    make: Callable[[np.random.Generator], FloatArray], trials: int
) -> None:
    rng = np.random.default_rng(77)
    false = sum(bool(spectrum(make(rng)).humps) for _ in range(trials))
    assert false <= stats.binom.ppf(0.9999, trials, 0.01)
