"""`import gyrofleet` on arrays: deviations as allantools has them, coefficients as planted, bad input reported."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import allantools
import numpy as np
import pytest

import gyrofleet as gf
from stream.errors import BadInput, GyrofleetError, NotEnoughData


@pytest.mark.long
@pytest.mark.parametrize("kind", ["oadev", "adev", "mdev", "ohdev", "hdev"])
@pytest.mark.parametrize("rate_hz", [1.0, 300.0])
def test_deviations_are_those_of_allantools(kind: str, rate_hz: float) -> None:
    values = np.cumsum(np.random.default_rng(1).normal(size=5000)) + np.random.default_rng(2).normal(size=5000)
    found = gf.allan_deviation(values, rate_hz, deviation=kind)
    taus, expected, _, _ = getattr(allantools, kind)(values, rate=rate_hz, data_type="freq", taus=found.tau_s)
    np.testing.assert_allclose(found.tau_s[: len(taus)], taus, rtol=1e-12)
    np.testing.assert_allclose(found.deviation[: len(taus)], expected, rtol=1e-9)
    assert len(taus) >= len(found.tau_s) - 1
    assert bool(((found.lo < found.deviation) & (found.deviation < found.hi)).all())


def test_angular_rates_come_in_deg_per_h_and_others_as_they_are() -> None:
    values = np.random.default_rng(3).normal(size=1000)
    plain = gf.allan_deviation(values, 10.0)
    rate = gf.allan_deviation(values, 10.0, unit_of_measure="deg/s")
    assert (plain.unit_of_measure, rate.unit_of_measure) == ("1", "deg/h")
    np.testing.assert_allclose(rate.deviation, 3600 * plain.deviation, rtol=1e-12)


def test_missing_samples_keep_their_place() -> None:
    values = np.random.default_rng(4).normal(size=2000)
    gappy = values.copy()
    gappy[[3, 700, 701]] = np.nan
    found = gf.allan_deviation(gappy, 1.0)
    expected = np.sqrt(np.nanmean(np.diff(gappy) ** 2) / 2)  # neighbours of which both are there
    np.testing.assert_allclose(found.deviation[0], expected, rtol=1e-12)
    assert found.curve.missing == 3


def test_masked_samples_are_missing() -> None:
    values = np.random.default_rng(8).normal(size=500)
    masked = gf.allan_deviation(np.ma.masked_greater(values, 2.0), 1.0)
    gappy = gf.allan_deviation(np.where(values > 2.0, np.nan, values), 1.0)
    np.testing.assert_array_equal(masked.deviation, gappy.deviation)
    assert masked.curve.missing > 0


@pytest.mark.long
def test_planted_coefficients_are_covered() -> None:
    rng = np.random.default_rng(5)
    rate_hz, n = 10.0, 200_000
    walk = np.cumsum(rng.normal(0.0, 0.5 * np.sqrt(1 / rate_hz / 3600), n))  # K = 0.5 deg/h/sqrt(h)
    white = rng.normal(0.0, 0.02 * 60 * np.sqrt(rate_hz), n)  # N = 0.02 deg/sqrt(h)
    fit = gf.noise_fit(gf.allan_deviation(walk + white, rate_hz, unit_of_measure="deg/h"))
    assert fit.angle_random_walk.lo < 0.02 < fit.angle_random_walk.hi
    assert fit.rate_random_walk.lo < 0.5 < fit.rate_random_walk.hi


def test_frames_and_plots(tmp_path: Path) -> None:
    found = gf.allan_deviation(np.random.default_rng(6).normal(size=1000), 10.0)
    assert found.polars().columns == ["tau_s", "deviation", "lo", "hi", "edf", "n"]
    assert found.plot(tmp_path / "a.png").stat().st_size > 20_000


BAD: list[tuple[Any, dict[str, Any], type[Exception], str]] = [
    ([1.0], {}, NotEnoughData, "1 seen"),
    ([], {}, NotEnoughData, "0 seen"),
    ([np.nan] * 10, {}, NotEnoughData, "seen"),
    ([[1.0, 2.0]], {}, BadInput, r"shape \(1, 2\)"),
    (["a"], {}, BadInput, "texts: one number a sample"),
    ([1.0, 2.0, 3.0], {"rate_hz": 0.0}, BadInput, "rate_hz is 0"),
    ([1.0, 2.0, 3.0], {"rate_hz": 1e-12}, BadInput, "from 3.5e-09 to 1e9"),
    ([1.0, 2.0, 3.0], {"rate_hz": "10"}, BadInput, "rate_hz is '10'"),
    ([1.0, 2.0, 3.0], {"points_per_octave": 3}, BadInput, "1, 2, 4 or 8"),
    ([1.0, np.inf, 3.0], {}, BadInput, "value 1 is infinite"),
    ([1.0, 2.0j, 3.0], {}, BadInput, "complex"),
    (np.arange(3).astype("datetime64[s]"), {}, BadInput, "values are times"),
    ([True, False, True], {}, BadInput, "true and false"),
    ([True, 1.0, 2], {}, BadInput, "true and false"),
    (np.array([1.0, np.True_, 2], object), {}, BadInput, "true and false"),
    (np.zeros(9, [("rate", float)]), {}, BadInput, "records of fields"),
    ([1.0, 2.0, 3.0], {"deviation": ["oadev"]}, BadInput, "choose one of"),
    (["1", "2", "3"], {}, BadInput, "texts"),
    (None, {}, BadInput, "values are nothing"),
    ([1.0, 2.0, 3.0], {"rate_hz": float("nan")}, BadInput, "rate_hz is nan"),
    ([1.0, 2.0, 3.0], {"deviation": "tdev"}, BadInput, "choose one of"),
    ([1.0, 2.0, 3.0], {"unit_of_measure": "parsnips"}, BadInput, "parsnips"),
    ([10**400, 1, 2], {}, BadInput, "give them less an offset"),
    ([2**70, 2**70 + 1, 2**70], {}, BadInput, "give them less an offset"),
]


@pytest.mark.parametrize(("values", "words", "error", "message"), BAD)
def test_bad_input_is_told(values: Any, words: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        gf.allan_deviation(values, **({"rate_hz": 1.0} | words))


@pytest.mark.long
def test_coefficients_of_what_is_no_angular_rate_are_refused() -> None:
    values = np.random.default_rng(7).normal(size=1000)
    with pytest.raises(BadInput, match="unit_of_measure"):
        gf.noise_fit(gf.allan_deviation(values, 1.0))
    with pytest.raises(BadInput, match="mdev"):
        gf.noise_fit(gf.allan_deviation(values, 1.0, unit_of_measure="deg/h", deviation="mdev"))
    with pytest.raises(gf.BadInput, match="what allan_deviation gives"):
        gf.noise_fit(values)  # type: ignore[arg-type]


def test_a_package_of_another_owner_is_told_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "storage.py").write_text("")
    done = subprocess.run([sys.executable, "-c", "import gyrofleet"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "gyrofleet needs its own package 'storage', but Python finds" in done.stderr.splitlines()[-1]
    assert "storage.py first: rename that file" in done.stderr.splitlines()[-1]


def test_what_is_not_offered_is_told() -> None:
    assert {"allan_deviation", "open_store", "BadInput"} <= set(dir(gf))
    assert "metrics" not in dir(gf)  # a command, not a function
    with pytest.raises(AttributeError):
        gf.metrics  # noqa: B018
    with pytest.raises(AttributeError, match="it has BadInput, DeviationCurve, FleetStore"):
        gf.alan_deviation  # noqa: B018


@pytest.mark.long
def test_what_the_guide_shows_of_arrays_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    guide = (Path(__file__).parents[3] / "docs" / "how-to" / "python.md").read_text(encoding="utf-8")
    code = guide.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["curve"].unit_of_measure == "deg/h"
    assert found["fit"].angle_random_walk.lo < 0.002 * 60 / np.sqrt(100) < found["fit"].angle_random_walk.hi
    assert (tmp_path / "allan.png").stat().st_size > 20_000


def test_a_term_that_is_not_observable_has_a_bound_and_no_value() -> None:
    white = np.random.default_rng(3).normal(0.0, 6.0, 100_000)
    fit = gf.noise_fit(gf.allan_deviation(white, rate_hz=100.0, unit_of_measure="deg/h"))
    assert fit.angle_random_walk.observable
    assert fit.angle_random_walk.value > 0.0
    assert not fit.rate_ramp.observable
    assert np.isnan(fit.rate_ramp.value)
    assert fit.rate_ramp.hi > 0.0


def test_a_series_whose_times_are_not_the_rate_is_refused() -> None:
    """The samples alone do not show a gap, another order or another rate."""
    pd = pytest.importorskip("pandas")
    values = np.random.default_rng(1).normal(size=1000)
    series = pd.Series(values, index=pd.date_range("2026-01-01", periods=1000, freq="10ms"))
    assert gf.allan_deviation(series, 100.0).deviation[0] == gf.allan_deviation(values, 100.0).deviation[0]
    zoned = series.tz_localize("Asia/Shanghai")
    for wrong, rate_hz in (
        (series, 1.0),
        (zoned, 1.0),
        (series, 80.0),  # each step within half an interval of it, a thousand of them far away
        (series, 101.0),
        (series.drop(series.index[10:20]), 100.0),
        (series.iloc[::-1], 100.0),
    ):
        with pytest.raises(BadInput, match="the index has"):
            gf.allan_deviation(wrong, rate_hz)
    assert gf.allan_deviation(series.drop(series.index[10:20]).asfreq("10ms"), 100.0).n[0] < 999
    times = series.index
    durations = pd.to_timedelta(np.arange(1000) * 0.01, unit="s")
    for index in (
        times.astype(object), zoned.index.astype(object), durations, durations.astype(object), times.to_period("ms"),
        pd.MultiIndex.from_arrays([["A-1"] * 1000, times]), pd.CategoricalIndex(times),
    ):  # fmt: skip
        gf.allan_deviation(pd.Series(values, index=index), 100.0)
        with pytest.raises(BadInput, match=r"the index has 0\.01 s between samples 0 and 1, and rate_hz=200"):
            gf.allan_deviation(pd.Series(values, index=index), 200.0)
    with pytest.raises(BadInput, match=r"the index has no time at sample 3 \(1 in all\)"):
        gf.allan_deviation(series.set_axis(times.where(np.arange(1000) != 3)), 100.0)
    for short in (series.iloc[:0], series.iloc[:1]):
        with pytest.raises(GyrofleetError, match="sample"):
            gf.allan_deviation(short, 100.0)


def test_integers_that_floats_would_round_are_refused() -> None:
    counts = np.random.default_rng(1).integers(-1000, 1000, 4096)
    for offset in (2**53, -(2**60)):
        with pytest.raises(BadInput, match=r"2\*\*53"):
            gf.allan_deviation(counts + offset, 10.0)
    below = gf.allan_deviation(counts + 2**52, 10.0).deviation
    np.testing.assert_allclose(below, gf.allan_deviation(counts, 10.0).deviation, rtol=1e-9)


@pytest.mark.parametrize("share", [0.02, 0.08])
def test_bounds_cover_the_truth_where_samples_are_missing_here_and_there(share: float) -> None:
    """At the averaging times of a hundredth to a tenth of a second to seconds: 95 % bounds, 8 records."""
    covered = asked = coefficients = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        values = rng.normal(0.0, 6.0, 200_000)  # N = 6/60/sqrt(100) deg/sqrt(h)
        values[rng.random(values.size) < share] = np.nan
        curve = gf.allan_deviation(values, 100.0, unit_of_measure="deg/h")
        truth = 0.6 / np.sqrt(curve.tau_s)
        short = curve.tau_s < 3.0
        covered += int(np.count_nonzero(((curve.lo <= truth) & (truth <= curve.hi))[short]))
        asked += int(np.count_nonzero(short))
        found = gf.noise_fit(curve).angle_random_walk
        coefficients += found.lo <= 0.01 <= found.hi
        assert f"{np.isnan(values).mean():.1%} of the samples are missing" in curve.remark
    # 95 % at least; neighbouring times are correlated, so that about 4 of 9 count: 3 standard deviations
    assert covered / asked >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / (8 * 4))
    assert coefficients >= 5  # 2e-4 by chance at 95 %


def test_one_long_gap_is_named_as_one_and_raises_nothing_where_no_average_spans_it() -> None:
    values = np.random.default_rng(1).normal(size=50_000)
    gappy = values.copy()
    gappy[20_000:25_000] = np.nan
    found, whole = gf.allan_deviation(gappy, 10.0), gf.allan_deviation(values, 10.0)
    assert found.remark.startswith(
        "10.0% of the samples are missing, nearly all in one gap of 500 s: averages that lack"
    )
    assert "too high" not in found.remark
    short = found.tau_s < 20.0
    np.testing.assert_allclose(found.deviation[short], whole.deviation[: short.sum()], rtol=0.02)  # it said 5.4 %
    gappy = values.copy()
    gappy[20_000:21_000] = np.nan
    long = gf.allan_deviation(gappy, 10.0).remark
    assert "from 1000 s on they span the gap, and white noise may be shown up to 5.4% too high" in long


def test_a_curve_says_that_outliers_raise_it() -> None:
    values = np.random.default_rng(1).normal(size=20_000)
    assert gf.allan_deviation(values, 10.0).remark == ""
    values[5000] = 1e6
    assert "1 isolated outliers, up to 1e+06 times" in gf.allan_deviation(values, 10.0).remark


def test_arguments_that_are_no_number_are_refused_with_a_sentence() -> None:
    values = np.random.default_rng(4).normal(size=64)
    ragged: Any = [1.0, [2.0, 3.0]]
    with pytest.raises(BadInput, match="rows of several lengths"):
        gf.allan_deviation(ragged, 1.0)
    wrong: list[Any] = [True, np.True_, np.array([100.0]), np.array([1.0, 2.0]), [1.0], "1", None, 1j]
    for rate_hz in wrong:
        with pytest.raises(BadInput, match="a number of samples a second is expected"):
            gf.allan_deviation(values, rate_hz)
    for far in (10**400, 0, -1.0, float("nan")):
        with pytest.raises(BadInput, match=r"from 3\.5e-09 to 1e9"):
            gf.allan_deviation(values, far)
    with pytest.raises(BadInput, match="points_per_octave is True"):
        gf.allan_deviation(values, 1.0, points_per_octave=True)
    of_no_dimension: Any = np.array(100.0)
    zero_dimensional = gf.allan_deviation(values, of_no_dimension)
    assert zero_dimensional.deviation.tolist() == gf.allan_deviation(values, 100).deviation.tolist()


def test_noise_whose_squares_vanish_is_refused() -> None:
    noise = np.random.default_rng(5).normal(size=1000)
    for unit_of_measure in ("1", "deg/s"):
        with pytest.raises(NotEnoughData, match="differ by too little to be squared"):
            gf.allan_deviation(1e-200 * noise, 100.0, unit_of_measure=unit_of_measure)


def test_units_are_those_that_the_import_knows() -> None:
    values = np.random.default_rng(6).normal(size=1000)
    usual = gf.allan_deviation(values, 100.0, unit_of_measure="deg/h")
    for spelling in ("度/小时", "dph", "°/h", "deg/hr", "deg/H"):
        found = gf.allan_deviation(values, 100.0, unit_of_measure=spelling)
        assert found.unit_of_measure == "deg/h"
        np.testing.assert_allclose(found.deviation, usual.deviation, rtol=1e-12)
    per_second = gf.allan_deviation(values, 100.0, unit_of_measure="度/秒")
    np.testing.assert_allclose(per_second.deviation, 3600.0 * usual.deviation, rtol=1e-12)
    assert gf.allan_deviation(values, 100.0, unit_of_measure="伏").unit_of_measure == "V"
    with pytest.raises(gf.UnknownUnit, match="flurb"):
        gf.allan_deviation(values, 100.0, unit_of_measure="flurb")
