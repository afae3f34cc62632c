"""Tables and curves of the residual before and after, compared with planted effects."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.report.drivers import bias_over_temperature, drawn, scale_factor_over_rate
from analytics.loop.report.wording import Wording
from analytics.loop.residuals import Residuals, residual_allan, whitened_spectrum
from analytics.loop.tracing.result.diagnosis_result import EffectCoefficient
from tests.diagnosed_units import SHUPE, SQUARE, a_finding, diagnosed, left


def test_residuals_are_those_of_the_models_and_the_held_out_set_is_the_last_third() -> None:
    found = diagnosed()
    residuals = left(found)
    names = [run.run for run in found.data.runs]
    stack = residuals.record.stack
    reported = {names[number] for number in np.unique(stack.run_number[residuals.held_out])}
    assert reported == set(names[6:])
    assert found.diagnosis.model is not None
    expected = np.concatenate([found.diagnosis.model.residual(run) for run in stack.runs])
    np.testing.assert_allclose(residuals.after, expected, rtol=0, atol=1e-12)
    assert found.diagnosis.error is not None
    told_error = found.diagnosis.error.rows[0]  # of one block
    rms = [np.sqrt(np.mean(each[residuals.judged] ** 2)) for each in (residuals.before, residuals.after)]
    np.testing.assert_allclose(rms, [told_error.before, told_error.after], rtol=1e-9)


def test_noise_variance_is_that_of_the_dense_covariance_over_gaps_and_runs() -> None:
    residuals = left(diagnosed())
    record = residuals.record
    keep = np.ones(len(record), dtype=bool)
    keep[30:70] = keep[100:101] = False
    part = record.stack.part(keep)
    thinned = replace(residuals, record=replace(record, stack=part, steps=part.steps, white=record.white[keep]))
    weights = np.random.default_rng(1).standard_normal(len(part))
    dense = 0.0
    for run in np.unique(part.run_number):
        own = part.run_number == run
        covariance = record.noise_model.covariance(
            residuals.noise, part.slot[own].astype(float), thinned.record.white[own]
        )
        dense += weights[own] @ covariance @ weights[own]
    assert thinned.noise_variance(weights) == pytest.approx(dense, rel=1e-9)


def test_allan_deviation_of_the_residual_is_the_definition_and_leaves_out_gaps() -> None:
    residuals = left(diagnosed())
    record = residuals.record
    chosen = np.flatnonzero(residuals.held_out)
    gap = chosen[20:25]
    keep = np.ones(len(record), dtype=bool)
    keep[gap] = False
    part = record.stack.part(keep)
    thinned = Residuals(
        replace(record, stack=part), residuals.noise, residuals.before[keep], residuals.after[keep],
        residuals.held_out[keep],
    )  # fmt: skip
    at = {each.tau_s: each for each in residual_allan(thinned)}
    squares = []
    for run in np.unique(part.run_number[thinned.held_out]):
        rows = np.flatnonzero(part.run_number == run)
        by_slot = dict(zip(part.slot[rows].tolist(), thinned.after[rows].tolist(), strict=True))
        for start in range(max(by_slot) + 1):
            values = [by_slot.get(start + step) for step in range(8)]
            if None not in values:
                numbers = np.array(values, dtype=float)
                squares.append((numbers[4:].mean() - numbers[:4].mean()) ** 2)
    assert at[120.0].differences == len(squares)
    assert at[120.0].after == pytest.approx(np.sqrt(np.mean(squares) / 2), rel=1e-9)
    assert at[120.0].lo < at[120.0].after < at[120.0].hi


def test_long_allan_deviation_falls_to_the_noise_with_the_effect() -> None:
    deviations = [each for each in residual_allan(left(diagnosed())) if each.tau_s >= 240]
    assert max(each.before / each.after for each in deviations) > 2
    assert all(each.lo < each.floor * 1.5 for each in deviations)  # the floor is within reach of the limits


def test_bias_over_temperature_shows_what_was_planted_and_then_only_noise() -> None:
    found = diagnosed("temperature_squared", SQUARE)
    residuals = left(found)
    table = bias_over_temperature(residuals)
    assert table is not None
    assert table.channel == "temperature"
    errors = np.array([[each.before, each.after, each.floor] for each in table.classes])
    before, after, floor = errors.T
    # 5 standard deviations: one in 10^6 in each of 8 classes, the error of the fitted coefficients is far less
    assert np.all(np.abs(after) < 5 * floor)
    assert np.ptp(before - after) > 3 * np.ptp(after)
    assert sum(each.blocks for each in table.classes) <= np.count_nonzero(residuals.held_out)


def test_scale_factor_over_rate_finds_a_planted_error_in_ppm() -> None:
    residuals = left(diagnosed())
    rate = residuals.channel("input_rate")
    wrong = replace(residuals, before=residuals.after + 25e-6 * 3600.0 * rate)
    table = scale_factor_over_rate(wrong)
    assert table is not None
    assert table.unit_of_measure == "ppm"
    for each in table.classes:
        assert each.before - each.after == pytest.approx(25.0, rel=1e-9)
        assert abs(each.after) < 5 * each.floor


def test_whitened_spectrum_is_one_with_the_effect_and_above_without() -> None:
    spectrum = whitened_spectrum(left(diagnosed()))
    assert spectrum is not None
    inside = np.mean((spectrum.after > spectrum.lo) & (spectrum.after < spectrum.hi))
    assert inside >= 0.7  # 95 % expected of about 16 bins; fewer than 12 of 16 has a chance of 1e-4
    assert np.max(spectrum.before / spectrum.hi) > 2


@pytest.mark.long
@pytest.mark.parametrize(("name", "size", "over"), [
    ("temperature_squared", SQUARE, "temperature (degC)"),
    ("temperature_rate", SHUPE, "temperature rate (Shupe) (degC/s)"),
])  # fmt: skip
def test_an_effect_is_drawn_over_what_it_is_a_function_of(name: str, size: float, over: str) -> None:
    found = diagnosed(name, size)
    effect = next(each for each in found.diagnosis.effects if each.name == name)
    shown = drawn(left(found), effect, Wording("en", found.data.runs[0]))
    assert shown is not None
    assert shown.label == over
    # the partial residual follows the prediction with a slope of one
    slope = np.polyfit(shown.predicted, shown.partial, 1)[0]
    assert slope == pytest.approx(1.0, abs=0.1)


def test_a_jump_is_drawn_over_the_time_of_its_run_and_a_line_is_not() -> None:
    found = diagnosed()
    residuals = left(found)
    stack = residuals.record.stack
    run = stack.runs[2]
    step = 3.0 * ((stack.run_number == 2) & (stack.column(lambda each: each.time_s) > 3600.0))
    with_jump = replace(residuals, after=residuals.after + step)
    size = (EffectCoefficient("", 3.0, 2.9, 3.1, "deg/h"),)
    jump = a_finding(name="jump", parameters={"run": run.run, "at_s": 3600.0}, coefficients=size)
    shown = drawn(with_jump, jump, Wording("en"))
    assert shown is not None
    assert shown.driver.size == len(run)
    seen = shown.partial[shown.driver > 3600].mean() - shown.partial[shown.driver < 3600].mean()
    quiet = residuals.after[stack.run_number == 2]
    noise = quiet[shown.driver > 3600].mean() - quiet[shown.driver < 3600].mean()
    assert seen == pytest.approx(3.0 + noise, rel=1e-9)
    assert drawn(residuals, a_finding(name="periodic_line", parameters={"frequency_hz": 0.01}), Wording("en")) is None
