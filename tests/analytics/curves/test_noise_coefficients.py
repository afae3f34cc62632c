"""Noise coefficients of a curve of the store: their terms, JSON, table and drawing."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import UUID

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from analytics.curves import normalised_walk
from analytics.curves.allan_curve import AllanCurve
from analytics.curves.noise_coefficients import NoiseCoefficients, curve_document, noise_coefficients, noise_table
from analytics.plots import allan_plot
from analytics.plots.allan_marks import draw_fit
from analytics.plots.allan_plot import plot_allan
from storage.sql.reading import SignalRecord
from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import MarkovNoise, NoiseCoefficient, NoiseFit
from stream.estimators.noise.noise_model import TERMS
from stream.estimators.noise.normalised_random_walk import NormalisedRandomWalk, angle_random_walk_normalised

UNITS = {term.key: term.unit_of_measure for term in TERMS}
NONE = NoEstimate("sample interval of 0.1 s: the standard asks for less")


def curve(*, walk: float = 0.02, instability: float = 0.1, points: int = 18) -> AllanCurve:
    tau_s = 0.1 * 2.0 ** np.arange(points)
    adev = np.sqrt(3600 * walk**2 / tau_s + 2 * np.log(2) / np.pi * instability**2)
    edf = 1e5 / tau_s
    relative = 2 / np.sqrt(2 * edf)
    columns = (tau_s, adev, adev / (1 + relative), adev * (1 + relative), edf)
    taus_s, values, lo, hi, degrees = (tuple(each.tolist()) for each in columns)
    return AllanCurve("FOG-1", "rate", "r1", "deg/h", 0.1, 200_000, 0, taus_s, values, lo, hi, degrees)


def coefficient(key: str, value: float, *, observable: bool = True) -> NoiseCoefficient:
    unit = UNITS.get(key, "deg/h/sqrt(h)")
    reason = "" if observable else f"at most {value * 1.1} {unit}"
    return NoiseCoefficient(
        value=value, lo=value * 0.9, hi=value * 1.1, unit_of_measure=unit, observable=observable, reason=reason
    )


@pytest.fixture
def every_term() -> NoiseCoefficients:
    """A model of all six terms, the rate ramp not observable."""
    values = dict(zip(UNITS, (0.03, 0.02, 0.1, 0.5, 1.0), strict=True))
    terms = {key: coefficient(key, value, observable=key != "rate_ramp") for key, value in values.items()}
    markov = MarkovNoise(
        amplitude=coefficient("markov_noise", 2.0), correlation_s=20.0, correlation_lo_s=10.0, correlation_hi_s=40.0
    )
    fit = NoiseFit(**terms, markov=markov, confidence=0.95, points=18, misfit=0.0)  # type: ignore[arg-type]
    return NoiseCoefficients(fit, coefficient("angle_random_walk", 0.021))


def test_planted_coefficients_are_found_and_the_model_follows_the_curve() -> None:
    planted = curve()
    found = noise_coefficients(planted, NONE)
    assert isinstance(found, NoiseCoefficients)
    assert found.fit.angle_random_walk.value == pytest.approx(0.02, rel=1e-3)
    assert found.fit.bias_instability.value == pytest.approx(0.1, rel=1e-2)
    np.testing.assert_allclose(found.deviation(np.array(planted.tau_s)), planted.adev, rtol=1e-3)
    assert found.agreeing(planted) == 18
    assert found.agreeing(replace(planted, lo=planted.hi)) == 0


def test_terms_are_those_of_the_standard_in_its_units(every_term: NoiseCoefficients) -> None:
    at_1_h = np.array([3600.0])
    variance = {each.term.symbol: float(each.variance(at_1_h)[0]) for each in every_term.terms}
    assert variance["Q"] == pytest.approx(3 * 0.03**2 / 3600**2)
    assert variance["N"] == pytest.approx(0.02**2)  # an hour's average of N deg/sqrt(h)
    assert variance["B"] == pytest.approx(2 * np.log(2) / np.pi * 0.1**2)
    assert variance["K"] == pytest.approx(0.5**2 / 3)
    assert variance["R"] == pytest.approx(1.0**2 / 2)
    assert variance["q"] == pytest.approx((2.0 * 20 / 3600) ** 2, rel=0.02)
    assert every_term.deviation(at_1_h)[0] ** 2 == pytest.approx(sum(variance.values()))


def test_the_json_names_every_coefficient(every_term: NoiseCoefficients) -> None:
    document = msgspec.json.decode(msgspec.json.encode(curve_document(curve(), every_term)))
    coefficients = document["coefficients"]
    assert list(coefficients) == [*UNITS, "markov", "angle_random_walk_normalised"]
    shape = ["value", "lo", "hi", "unit_of_measure", "observable", "reason"]
    for key in (*UNITS, "angle_random_walk_normalised"):
        assert list(coefficients[key]) == shape
    assert list(coefficients["markov"]) == ["amplitude", "correlation_s", "correlation_lo_s", "correlation_hi_s"]
    assert list(coefficients["markov"]["amplitude"]) == shape
    assert (document["confidence"], document["coefficients_reason"]) == (0.95, None)
    assert document["tau_s"] == list(curve().tau_s)
    without = replace(every_term, normalised=NONE, fit=msgspec.structs.replace(every_term.fit, markov=None)).document()
    assert without["markov"] is None
    assert list(without["angle_random_walk_normalised"]) == shape
    assert without["angle_random_walk_normalised"]["value"] is None
    assert without["angle_random_walk_normalised"]["reason"] == NONE.reason


def test_where_there_is_no_fit_the_reason_names_the_record() -> None:
    for wrong, words in (
        (replace(curve(), unit_of_measure="degC", signal="temperature"), "is in degC.*angular rate; choose a signal"),
        (curve(points=5), "6 averaging times with a deviation above zero needed, 5 given"),
        (replace(curve(), adev=(0.0,) * 18), "is 0 at every averaging time"),
    ):
        found = noise_coefficients(wrong, NONE)
        assert isinstance(found, NoEstimate)
        assert found.reason.startswith(f"unit FOG-1, signal {wrong.signal}, run r1: ")
        with pytest.raises(AssertionError, match=words):
            raise AssertionError(found.reason)
        document = curve_document(wrong, found)
        assert document["coefficients"] is None
        assert document["coefficients_reason"] == found.reason


def test_the_table_is_bilingual_and_says_what_is_not_observable(every_term: NoiseCoefficients) -> None:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(noise_table(curve(), every_term))
        console.print(noise_table(curve(), replace(every_term, normalised=NONE)))
    lines = capture.get().splitlines()
    for each in every_term.terms:
        (line, _) = (line for line in lines if f"{each.term.names['en']} {each.term.names['zh']} " in line)
        assert ("not observable (不可观测): at most 1.1" in line) == (each.term.symbol == "R")
        assert bool(re.search(rf"│ +{each.coefficient.lo:#.4g} │", line)) == each.coefficient.observable
    normalised = [line for line in lines if "归一化法" in line and "│" in line]
    assert "0.02100 │" in normalised[0]
    assert NONE.reason in normalised[1]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_model_is_drawn_with_its_terms(every_term: NoiseCoefficients, language: str) -> None:
    axes = Figure().add_subplot(xscale="log", yscale="log", xlim=(0.05, 2e4), ylim=(0.01, 20))
    draw_fit(axes, every_term, curve().tau_s, language, "model")
    legend = axes.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[0] == "model"
    # the rate ramp is not observable, but bends the model
    assert len(labels) == len(axes.lines) == 1 + len(every_term.terms)
    for label, each in zip(labels[1:], every_term.terms, strict=True):
        is_told = label.endswith({"en": "not observable", "zh": "不可观测"}[language])
        assert is_told == (not each.coefficient.observable)
        assert label.startswith(f"{each.term.names[language]}  {each.term.symbol} = {each.coefficient.value:g} (")
    assert "N = 0.02 (0.018 – 0.022) deg/√h" in labels[2]
    assert labels[-1].endswith("deg/h/√h, 20 s")
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.05, 2e4), (0.01, 20))


def test_a_model_that_describes_nothing_says_so_and_where_one_departs_is_told() -> None:
    planted = curve()
    found = noise_coefficients(planted, NONE)
    assert isinstance(found, NoiseCoefficients)
    assert found.describes
    assert found.farthest(planted) == (planted.tau_s[0], 1.0)
    bent = replace(planted, adev=(*planted.adev[:9], 2 * planted.adev[9], *planted.adev[10:]),
                   lo=(*planted.lo[:9], 1.9 * planted.adev[9], *planted.lo[10:]),
                   hi=(*planted.hi[:9], 2.1 * planted.adev[9], *planted.hi[10:]))  # fmt: skip
    at_s, ratio = found.farthest(bent)
    assert at_s == planted.tau_s[9]
    assert ratio == pytest.approx(0.5, rel=1e-2)
    departing = NoiseCoefficients(msgspec.structs.replace(found.fit, misfit=0.1), NONE)
    assert "50% too low at 51.2 s" in str(noise_table(bent, departing).caption)
    useless = NoiseCoefficients(msgspec.structs.replace(found.fit, misfit=0.5), NONE)
    assert not useless.describes
    assert "do not describe the curve (模型不适用)" in str(noise_table(bent, useless).caption)


@pytest.mark.long
def test_the_plot_carries_the_model_of_the_chosen_unit(tmp_path: Path) -> None:
    found = noise_coefficients(curve(), NONE)
    assert isinstance(found, NoiseCoefficients)
    others = [replace(curve(walk=0.05), unit="FOG-2")]
    plot_allan([*others, curve()], tmp_path / "a.png", chosen="FOG-1", found=found)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    plain = allan_plot._figure([curve()], [], None, None, "en").axes[0]
    fitted = allan_plot._figure([curve()], [], None, None, "en", found).axes[0]
    assert plain.get_legend() is None
    assert (plain.get_xlim(), plain.get_ylim()) == (fitted.get_xlim(), fitted.get_ylim())


def batches(
    values: FloatArray, dt_ns: int, *, skipped: tuple[int, ...] = (), irregular: bool = False
) -> Callable[..., list[SampleBatch]]:
    """A stand-in for the store: the values in batches of 1000, some of them never recorded."""

    def read(_catalog: object, record: SignalRecord) -> list[SampleBatch]:
        return [
            SampleBatch(
                record.unit, record.signal, record.run, UUID(int=1), i, i * dt_ns, dt_ns, record.unit_of_measure,
                values=values[i : i + 1000],
                times_ns=(i + np.arange(1000)) * dt_ns if irregular else None,
                irregular=irregular,
            )
            for i in range(0, len(values), 1000)
            if i // 1000 not in skipped
        ]  # fmt: skip

    return read


def test_the_normalised_random_walk_is_that_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    record = SignalRecord("FOG-1", "rate", "r1", "deg/s", 60_000, False)
    values = np.random.default_rng(7).standard_normal(60_000) * 0.02 * 60 / np.sqrt(0.005) / 3600

    def walk(**options: object) -> NoiseCoefficient | NoEstimate:
        settings: dict[str, Any] = {"values": values, "dt_ns": 5_000_000} | options
        monkeypatch.setattr(normalised_walk, "read_signal", batches(**settings))
        return normalised_walk.normalised_walk(None, record)  # type: ignore[arg-type]

    def direct(rates_deg_per_h: FloatArray) -> NoiseCoefficient:
        found = angle_random_walk_normalised(rates_deg_per_h, 0.005)
        assert isinstance(found, NormalisedRandomWalk)
        return found.coefficient

    whole = walk()
    assert whole == direct(values * 3600)
    with_gaps = values * 3600
    with_gaps[3000:6000] = with_gaps[30_000:31_000] = np.nan
    assert walk(skipped=(3, 4, 5, 30)) == direct(with_gaps) != whole
    monkeypatch.setattr(normalised_walk, "MOST_SLOTS", 12_500)
    assert walk() == direct(values[-12_500:] * 3600)
    slow, scattered = walk(dt_ns=10_000_000), walk(irregular=True)
    assert isinstance(slow, NoEstimate)
    assert "asks for less than 0.01 s" in slow.reason
    assert isinstance(scattered, NoEstimate)
    assert "lie on no grid" in scattered.reason
