"""Effects that only the biases of runs show, where nobody declared how much these scatter from power-on to power-on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.result.holdout import HeldOutAnswer
from analytics.loop.tracing.search.between_runs import calibrated_ratio
from analytics.loop.tracing.search.fitted_candidates import beside
from analytics.loop.tracing.search.run_biases import RunBiases
from analytics.loop.tracing.whitening.joint_fit import fit_jointly, nothing_more
from analytics.loop.tracing.whitening.stack import stacked
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.batch import FloatArray

DAY_NS = 86_400 * 10**9
START_NS = 20_000 * DAY_NS
BLOCKS = 120
MODEL = ErrorModel.parse("rate = bias")
SLOPE, SCATTER, WHITE = 0.02, 0.05, 0.11
WITHIN = ModelNoise(N=WHITE * np.sqrt(30.0 / 3600.0), B=0.005, K=0.005, turn_on=SCATTER)


def runs_at(levels: FloatArray, biases: FloatArray, rng: np.random.Generator) -> list[RunBlocks]:
    """A run a day, each at one temperature."""
    ones = np.ones(BLOCKS)
    return [
        RunBlocks(
            "U1", f"r{number:02}", "rate", np.arange(BLOCKS), 30.0, START_NS + number * DAY_NS,
            bias + WHITE * rng.standard_normal(BLOCKS), 300 * ones.astype(int), WHITE**2 * ones, "deg/h",
            {
                "temperature": Channel(rng.normal(level, 0.02, BLOCKS), 0.02 * ones, "degC"),
                "day": Channel(number * ones + (np.arange(BLOCKS) + 0.5) * 30.0 / 86_400.0, 0.0 * ones, "day"),
            },
        )
        for number, (level, bias) in enumerate(zip(levels, biases, strict=True))
    ]  # fmt: skip


@pytest.mark.parametrize("declared", [None, WITHIN])
def test_a_temperature_that_differs_between_runs_only_is_found(declared: ModelNoise | None) -> None:
    """Its effect on the biases is twelve times their scatter, which was estimated with the effect in it."""
    rng = np.random.default_rng(501)
    levels = rng.permutation(np.linspace(-20.0, 60.0, 12))
    biases = SCATTER * rng.standard_normal(12) + SLOPE * levels
    if declared is not None:  # as from Allan fits: the turn-on scatter is that of these very runs
        declared = ModelNoise(N=WITHIN.N, B=WITHIN.B, K=WITHIN.K, turn_on=float(np.std(biases, ddof=1)))
    found = diagnose(runs_at(levels, biases, rng), MODEL, declared_noise=declared, turn_on_is_declared=False)
    assert (found.verdict, found.names) == (ModelVerdict.EFFECT_FOUND, ("temperature",))
    size = found.effects[0].coefficients[0]
    assert size.lo < SLOPE < size.hi
    sentence = verdict_sentence(found, Wording("en"))
    assert "e-" not in sentence  # no decrease of nothing within the runs


def test_ageing_is_found_whose_trend_is_the_scatter_of_the_runs() -> None:
    """The estimate is of all runs, over which the bias ages further than over those of the training."""
    rng = np.random.default_rng(5)
    biases = 0.03 * rng.standard_normal(15) + 0.05 * np.arange(15)
    found = diagnose(runs_at(np.full(15, 25.0), biases, rng), MODEL)
    assert (found.verdict, found.names) == (ModelVerdict.EFFECT_FOUND, ("ageing",))


def test_a_level_that_rises_from_run_to_run_and_is_flat_within_them_is_no_ageing() -> None:
    """Runs of ten minutes eleven minutes apart: ageing by time would rise within each of them nearly as much."""
    rng = np.random.default_rng(8)
    runs, white = [], 0.03
    for number, run in enumerate(runs_at(np.full(8, 25.0), np.zeros(8), rng)):
        part = run.part(slice(0, 20))
        value = 0.06 * number + 0.02 * rng.standard_normal() + white * rng.standard_normal(20)
        day = np.asarray((11.0 * number + np.arange(20) * 0.5) / 1440.0, np.float64)
        channels = {**part.channels, "day": Channel(day, 0.0 * day, "day")}
        t0_ns = START_NS + number * 660 * 10**9
        runs.append(replace(part, value=value, white_variance=0 * value + white**2, channels=channels, t0_ns=t0_ns))
    found = diagnose(runs, MODEL)
    assert found.verdict is ModelVerdict.UNREPLICATED
    test = found.effects[0].of_biases
    assert test is not None
    assert test.within is not None
    inside, error = test.within
    assert abs(inside) < 3 * error < test.lo
    assert "within the runs the output does not follow it" in verdict_sentence(found, Wording("en"))


@pytest.mark.in_gate("0", "1")
@pytest.mark.parametrize("seed", range(6))
def test_a_walk_of_the_bias_at_rising_temperatures_is_no_function_of_temperature(seed: int) -> None:
    rng = np.random.default_rng(seed)
    biases = np.cumsum(0.1 * rng.standard_normal(12))
    found = diagnose(runs_at(np.linspace(-20.0, 60.0, 12), biases, rng), MODEL, declared_noise=WITHIN)
    assert found.verdict not in (ModelVerdict.EFFECT_FOUND, ModelVerdict.UNKNOWN_FUNCTION, ModelVerdict.CONFOUNDED)


def test_a_verdict_that_takes_the_scatter_of_the_runs_for_turn_on_says_so_first() -> None:
    rng = np.random.default_rng(2)
    found = diagnose(runs_at(np.full(12, 25.0), 0.3 * rng.standard_normal(12), rng), MODEL)
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    assert "attributed to turn-on scatter, which was not declared" in verdict_sentence(found, Wording("en"))
    assert "已视为逐次启动散布（未声明）" in verdict_sentence(found, Wording("zh"))
    known = diagnose(runs_at(np.full(12, 25.0), SCATTER * rng.standard_normal(12), rng), MODEL, declared_noise=WITHIN)
    assert "attributed" not in verdict_sentence(known, Wording("en"))


def p_value(columns: FloatArray, biases: FloatArray, rng: np.random.Generator) -> float:
    """Of columns that are constant in each run."""
    stack, _ = stacked(runs_at(np.zeros(biases.size), biases, rng), MODEL)
    record = record_of(stack, None)
    base = fit_jointly([record], nothing_more([record]))
    tried = columns[stack.run_number]
    joint, ratio = beside(base, base.hypothesis.with_common([tried]))
    return float(chi2.sf(calibrated_ratio(joint, ratio, tried.shape[1]), tried.shape[1]))


@pytest.mark.parametrize("trials", [80, pytest.param(160, marks=pytest.mark.long)])
def test_few_runs_show_nothing_more_often_than_promised(trials: int) -> None:
    """Biases of five independent runs against any two columns: p below 0.05 in 5 % (of all, by chance 1 in 1000).

    Without regard to the few runs it would be in 24 %.
    """
    rng = np.random.default_rng(8)
    found = [p_value(rng.standard_normal((5, 2)), SCATTER * rng.standard_normal(5), rng) for _ in range(trials)]
    assert sum(each < 0.05 for each in found) <= binom.ppf(0.999, trials, 0.05)


def test_as_many_coefficients_as_runs_show_nothing() -> None:
    rng = np.random.default_rng(9)
    found = [p_value(rng.standard_normal((6, 5)), SCATTER * rng.standard_normal(6), rng) for _ in range(10)]
    assert min(found) > 0.9


def test_a_jump_where_a_channel_steps_says_so() -> None:
    """A scale factor that differs from run to run, with steps of the rate: no channel explains it alike in all runs."""
    rng = np.random.default_rng(4)
    rate = np.repeat([0.0, 40.0, -40.0, 20.0], BLOCKS // 4)
    ones = np.ones(BLOCKS)
    runs = [
        RunBlocks(
            "U1", f"r{number}", "rate", np.arange(BLOCKS), 30.0, START_NS + number * DAY_NS,
            0.05 * rng.standard_normal(BLOCKS) + (0.05 * rate if number == 2 else 0.0), 300 * ones.astype(int),
            0.05**2 * ones, "deg/h", {"input_rate": Channel(rate * 1.0, 0.01 * ones, "deg/s")},
        )
        for number in range(6)
    ]  # fmt: skip
    found = diagnose(runs, MODEL)
    assert "jump" in found.names
    assert "jump in run r2 at 1,800 s: input_rate steps there" in " ".join(map(str, found.limits))


def undated(runs: list[RunBlocks], names: list[str]) -> list[RunBlocks]:
    """The runs with these names, without their dates."""
    return [
        replace(run, run=name, t0_ns=0, is_date_known=False,
                channels={key: each for key, each in run.channels.items() if key != "day"})
        for run, name in zip(runs, names, strict=True)
    ]  # fmt: skip


def test_without_dates_a_temperature_that_rises_from_run_to_run_is_not_told_from_ageing() -> None:
    rng = np.random.default_rng(77)
    levels = np.linspace(-20.0, 60.0, 12)
    runs = runs_at(levels, SCATTER * rng.standard_normal(12) + SLOPE * levels, rng)
    found = diagnose(undated(runs, [f"run{number}" for number in range(1, 13)]), MODEL)
    assert (found.verdict, found.names) == (ModelVerdict.CONFOUNDED, ("temperature",))
    assert [(each.name, each.recorded) for each in found.confounded] == [("ageing", False)]
    assert any("run1 to run12" in str(each) for each in found.limits)
    # in another order the temperature is the only name
    mixed = rng.permutation(12)
    found = diagnose(undated([runs[at] for at in mixed], [f"run{number}" for number in range(1, 13)]), MODEL)
    assert found.names == ("temperature",)
    assert "ageing" not in [each.name for each in found.confounded]


def test_runs_without_dates_are_in_the_order_of_the_numbers_in_their_names() -> None:
    rng = np.random.default_rng(78)
    runs = runs_at(rng.permutation(np.linspace(-20.0, 60.0, 12)), np.zeros(12), rng)
    names = [f"run{number}" for number in range(1, 13)]
    found = diagnose(undated(runs, names)[::-1], MODEL)
    assert found.runs == tuple(names)
    assert found.holdout is None or found.holdout.runs == tuple(names[8:])
    assert found.training_runs == tuple(names[:8])


def noise_of(biases: FloatArray) -> ModelNoise:
    """The noise of the runs, with the scatter of these very biases: as it is where none is declared."""
    scatter = 1.4826 * float(np.median(np.abs(biases - np.median(biases))))
    return ModelNoise(N=WITHIN.N, B=WITHIN.B, K=WITHIN.K, turn_on=scatter)


def with_gravity(runs: list[RunBlocks], gravity: FloatArray) -> list[RunBlocks]:
    """The runs, each in an attitude of its own."""
    return [
        replace(run, channels={**run.channels, "gravity_i": Channel(np.full(BLOCKS, each), np.zeros(BLOCKS), "g_0")})
        for run, each in zip(runs, gravity, strict=True)
    ]


def ageing(per_day: float, rng: np.random.Generator) -> Diagnosis:
    """The diagnosis of nine runs, a day apart, whose bias grows."""
    biases = SCATTER * rng.standard_normal(9) + per_day * np.arange(9)
    runs = runs_at(np.full(9, 25.0), biases, rng)
    return diagnose(runs, MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)


@pytest.mark.parametrize("seed", range(3))
def test_ageing_that_six_training_runs_take_for_scatter_is_found_by_the_biases_of_all_runs(seed: int) -> None:
    found = ageing(0.06, np.random.default_rng(seed))
    assert (found.verdict, found.names) == (ModelVerdict.EFFECT_FOUND, ("ageing",))
    test = found.effects[0].of_biases
    assert test is not None
    assert test.is_in_training
    assert test.lo < 0.06 < test.hi
    size = found.effects[0].coefficients[0]
    assert size.lo < 0.06 < size.hi


def test_an_attitude_that_differs_from_run_to_run_is_found_and_the_others_are_not_named() -> None:
    rng = np.random.default_rng(3)
    gravity = np.array([1.0, 0.0, -1.0] * 3)[rng.permutation(9)]
    biases = SCATTER * rng.standard_normal(9) + 0.3 * gravity
    runs = with_gravity(runs_at(np.full(9, 25.0), biases, rng), gravity)
    found = diagnose(runs, MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)
    assert (found.verdict, found.names, found.confounded) == (ModelVerdict.EFFECT_FOUND, ("gravity_i",), ())


def test_a_drift_that_only_all_runs_show_is_named_and_not_called_found() -> None:
    found = ageing(0.045, np.random.default_rng(4))
    assert (found.verdict, found.names) == (ModelVerdict.UNREPLICATED, ("ageing",))
    test = found.effects[0].of_biases
    assert test is not None
    assert not test.is_in_training
    assert test.lo < 0.045 < test.hi
    assert found.holdout is not None
    assert found.holdout.overall is not HeldOutAnswer.CONFIRMED
    assert "the biases of the 9 runs follow ageing over days: 0.0" in verdict_sentence(found, Wording("en"))
    assert "9次试验的零偏随长期老化变化" in verdict_sentence(found, Wording("zh"))


def test_biases_that_follow_nothing_have_p_values_as_promised() -> None:
    """Of six runs, one term that differs between them declared: Student's t is exact, whatever their scatter."""
    rng = np.random.default_rng(11)
    base, within = np.column_stack([np.ones(6), rng.standard_normal(6)]), 1e-8 * np.eye(6)
    slopes = [RunBiases(rng.standard_normal(6), within, base).slope(np.arange(6.0)) for _ in range(400)]
    by_chance = sum(each is not None and each.p_value < 0.05 for each in slopes)
    assert binom.ppf(0.001, 400, 0.05) <= by_chance <= binom.ppf(0.999, 400, 0.05)


@pytest.mark.parametrize("units", [8, pytest.param(80, marks=pytest.mark.long)])
def test_runs_in_three_attitudes_over_days_are_named_a_cause_no_more_often_than_promised(units: int) -> None:
    rng = np.random.default_rng(13)
    named = 0
    for _ in range(units):
        biases = SCATTER * rng.standard_normal(9)
        runs = with_gravity(runs_at(np.full(9, 25.0), biases, rng), np.array([1.0, 0.0, -1.0] * 3))
        found = diagnose(runs, MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)
        named += any(each.of_biases is not None for each in (*found.effects, *found.unreplicated))
    assert named <= binom.ppf(0.999, units, 0.01)


def test_the_noise_within_long_and_short_runs_counts() -> None:
    """Without scatter between them, a slope is as uncertain as the noise of the runs, at least."""
    runs = RunBiases(np.array([0.0, 0.1, -0.1, 0.1, 0.0]), np.diag([1.0, 1.0, 4.0, 1.0, 1.0]), np.ones((5, 1)))
    slope = runs.slope(np.arange(5.0))
    assert slope is not None
    assert slope.error == pytest.approx(1 / np.sqrt(10.0))  # the third run, in the middle, does not bear it
    assert runs.slope(np.ones(5)) is None
