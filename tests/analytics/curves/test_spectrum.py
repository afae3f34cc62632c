"""The spectrum of a stored signal: its levels, what a line needs to be seen, its plot."""

import math
from dataclasses import replace
from pathlib import Path
from uuid import UUID
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib.text import Text

from analytics.curves.spectrum import Level, SignalSpectrum, segment_for, spectrum_from
from analytics.plots import figure_file, spectrum_plot
from analytics.plots.spectrum_plot import plot_spectrum
from storage.sql.reading import SignalRecord
from stream.batch import FloatArray, SampleBatch
from stream.errors import BadInput, NotEnoughData
from stream.estimators.spectral_density import SpectralDensity

INTERVAL_S, SIGMA = 0.01, 3.0
LEVEL = 2.0 * SIGMA**2 * INTERVAL_S


def spectrum(values: FloatArray, segment_samples: int = 1024, unit_of_measure: str = "deg/h") -> SignalSpectrum:
    batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, unit_of_measure, values=values)
    record = SignalRecord("FOG-1", "rate", "r1", unit_of_measure, len(values), False)
    return spectrum_from(record, lambda: [batch], segment_samples)


def white(n: int = 40_000, seed: int = 1) -> FloatArray:
    return SIGMA * np.random.default_rng(seed).standard_normal(n)


def sines(n: int, *lines: tuple[float, float]) -> FloatArray:
    t_s = INTERVAL_S * np.arange(n)
    return sum((a * np.sin(2.0 * np.pi * f * t_s + f) for f, a in lines), np.zeros(n))


def texts(found: SignalSpectrum) -> list[str]:
    return [text.get_text() for text in spectrum_plot._figure(found).findobj(Text) if text.get_text()]


def test_limits_of_levels_cover_the_level_of_white_noise() -> None:
    edges = np.geomspace(0.2, 49.0, 30)
    trials = 100
    levels = [level for seed in range(trials) for level in spectrum(white(20_000, seed)).levels(edges)]
    held = sum(level.lo <= LEVEL <= level.hi for level in levels)
    # neighbouring bands share a correlated bin or two, hence the generous margin
    assert abs(held / len(levels) - 0.95) < 6.0 * math.sqrt(0.95 * 0.05 / len(levels))
    bands = len(levels) // trials
    assert np.mean([level.psd for level in levels[bands - 1 :: bands]]) == pytest.approx(LEVEL, rel=0.01)


def test_levels_leave_lines_out_and_bands_without_a_bin() -> None:
    n = 40_000
    found = spectrum(white(n) + sines(n, (12.34, 20.0)))
    (line,) = found.lines
    (level,) = found.levels(np.array([11.0, 14.0]))
    assert level.lo < LEVEL < level.hi
    assert line.background_ratio > 1000.0
    assert found.levels(np.array([12.3, 12.4])) == []
    assert found.levels(np.array([60.0, 70.0])) == []
    (single,) = found.levels(np.array([found.frequency_hz[40] * 0.999, found.frequency_hz[40] * 1.001]))
    expected = (found.frequency_hz[40], found.psd[40], found.lo[40], found.hi[40])
    assert (single.frequency_hz, single.psd, single.lo, single.hi) == pytest.approx(expected)


@pytest.mark.long
@pytest.mark.parametrize(("segments_of", "n"), [(1024, 40_000), (256, 40_000), (1024, 5000)])
def test_a_line_of_the_least_amplitude_is_found_as_often_as_not(segments_of: int, n: int) -> None:
    noise = spectrum(white(n), segments_of)
    (level,) = noise.levels(np.array([5.0, 45.0]))
    least = noise.least_amplitude(at_level(level.frequency_hz))
    assert least is not None
    frequency_hz = (round(20.0 / noise.bin_width_hz) + 0.5) * noise.bin_width_hz
    found = {}
    for times in (0.5, 1.0, 1.8):
        seen = [spectrum(white(n, s) + sines(n, (frequency_hz, times * least)), segments_of) for s in range(2, 42)]
        found[times] = sum(
            any(abs(line.frequency_hz - frequency_hz) < noise.bin_width_hz for line in each.lines) for each in seen
        )
    assert found[0.5] <= 4
    assert 14 <= found[1.0] <= 38
    assert found[1.8] >= 39
    outside = noise.searched_lo_hz - noise.bin_width_hz
    assert noise.least_amplitude(at_level(outside)) is None


def at_level(frequency_hz: float) -> Level:
    return Level(frequency_hz, LEVEL, LEVEL, LEVEL)


def test_the_document_is_what_json_shows() -> None:
    found = spectrum(white() + sines(40_000, (12.34, 5.0)))
    document = found.document()
    assert len(document["frequency_hz"]) == len(document["psd"]) == len(document["lo"]) == 510
    (line,) = document["lines"]
    assert line["frequency_lo_hz"] <= 12.34 <= line["frequency_hi_hz"]
    assert line["lo"] <= 5.0 <= line["hi"]
    assert line["unit_of_measure"] == "deg/h"
    assert document["searched_lo_hz"] == pytest.approx(30 / 10.24)
    assert document["searched_hi_hz"] == pytest.approx((512 - 29) / 10.24)
    with pytest.raises(BadInput, match="its columns differ in length"):
        replace(found, lo=())


@pytest.mark.parametrize("n", [1, 127, 128, 511, 512, 4607, 4608, 10**9])
def test_segments_are_powers_of_two_that_the_estimator_takes(n: int) -> None:
    size = segment_for(n)
    assert SpectralDensity(size).segment_samples == size
    assert size <= max(n, 128)
    if size > 512:
        assert (n - size) // (size // 2) + 1 >= 8


def test_too_little_is_refused_with_unit_and_run() -> None:
    with pytest.raises(NotEnoughData, match=r"unit FOG-1, signal rate, run r1: no power .* 100 samples seen"):
        spectrum(white(100), 128)
    with pytest.raises(NotEnoughData, match=r"run r1: no power spectral density: values too large .* check the source"):
        spectrum(1e300 * white(2000), 512)


def test_lines_are_numbered_with_frequency_and_amplitude() -> None:
    n = 40_000
    written = texts(spectrum(white(n) + sines(n, (12.34, 5.0), (24.68, 2.0))))
    assert {"Lines", "1", "2"} <= set(written) or {"Lines  谱线", "1", "2"} <= set(written)
    assert any(text.startswith("12.34") and text.endswith(" Hz") for text in written)
    amplitudes = sorted(float(text.split()[0]) for text in written if text.endswith(" deg/h"))
    assert amplitudes == pytest.approx([2.0, 5.0], rel=0.1)
    assert "One-sided power spectral density ((deg/h)²/Hz)" in written
    assert any("77 segments, resolution 0.0977 Hz" in text for text in written)


def test_many_lines_are_named_up_to_eleven() -> None:
    n = 80_000
    planted = [(2.0 * k + 3.0, 3.0 + 0.1 * k) for k in range(1, 16)]
    found = spectrum(white(n) + sines(n, *planted), 4096)
    assert len(found.lines) == 15
    written = texts(found)
    assert "and 4 weaker" in written
    assert sum(text.endswith(" Hz") and "segments" not in text for text in written) == 11


def test_without_a_line_that_is_written() -> None:
    written = texts(spectrum(white()))
    assert "Lines" not in written
    assert any("no line stands out from 2.93 to 47.2 Hz" in text for text in written)


def test_labels_are_english_where_no_chinese_font_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figure_file, "chinese_font", lambda: None)
    written = texts(spectrum(white() + sines(40_000, (12.34, 5.0))))
    assert "Lines" in written
    assert all(ord(character) < 0x2E80 for text in written for character in text)


@pytest.mark.long
@pytest.mark.parametrize("name", ["a.png", "a.PNG", "a.svg"])
def test_a_plot_of_few_segments_is_written(tmp_path: Path, name: str) -> None:
    plot_spectrum(spectrum(white(128), 128, "degC"), tmp_path / name)
    if name.endswith("svg"):
        assert ET.parse(tmp_path / name).getroot().tag.endswith("svg")
        assert "dc:date" not in (tmp_path / name).read_text(encoding="utf-8")
    else:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    found = spectrum(white())
    with pytest.raises(BadInput, match=r"a\.pdf: plots are written as \.png or \.svg"):
        plot_spectrum(found, tmp_path / "a.pdf")
    with pytest.raises(BadInput, match=r"cannot be written \(No such file or directory\)"):
        plot_spectrum(found, tmp_path / "none" / "a.png")
    with pytest.raises(BadInput, match="run r1: no density above 0 to draw; the output is constant"):
        plot_spectrum(spectrum(np.full(2000, 7.0), 512), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
