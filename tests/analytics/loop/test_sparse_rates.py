"""Rates that a table takes only at a few levels: what lies between them is not in the data, and is not made up."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.channel_coherence import copies_of_signal
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.residuals import residuals_of
from analytics.loop.tracing.diagnosis import diagnose
from stream.batch import FloatArray

BLOCK_S, DWELL = 10.0, 30  # of a level, blocks
MODEL = ErrorModel.parse("bias + scale_factor*input_rate")


def ladder(number: int, levels: tuple[float, ...], error: FloatArray, noise: float = 0.1) -> RunBlocks:
    """A run at rest between rates in both directions, deg/s, with an error for each level."""
    rng = np.random.default_rng(number)
    order = rng.permutation(len(levels))
    rate, wrong = np.repeat(np.array(levels)[order], DWELL), np.repeat(error[order], DWELL)
    size = rate.size
    value = 3600.0 * rate + wrong + 2.0 + rng.normal(0.0, noise, size)
    channels = {"input_rate": Channel(rate, np.zeros(size), "deg/s")}
    start_ns = number * 86_400 * 10**9
    one = np.ones(size)
    return RunBlocks(
        "U", f"r{number}", "rate", np.arange(size), BLOCK_S, start_ns, value, np.ones(size, int), one, "deg/h", channels
    )


def symmetric(*positive: float) -> tuple[float, ...]:
    return (*(-each for each in reversed(positive)), 0.0, *positive)


def test_the_unknown_function_has_knots_only_where_there_are_rates() -> None:
    levels = symmetric(0.005, 0.02, 0.05, 0.1)
    runs = [ladder(number, levels, np.zeros(len(levels))) for number in range(3)]
    function = effect("function_of_input_rate")
    (shape,) = function.shapes(runs)
    assert shape["knots"] == [-0.1, -0.05, -0.025, -0.005, 0.0, 0.005, 0.025, 0.05, 0.1]
    columns = np.concatenate([function.regressors(run, shape) for run in runs])
    assert np.linalg.cond(columns) < 100.0  # each coefficient is seen


def test_a_curve_with_few_levels_has_coefficients_of_its_own_size() -> None:
    levels = symmetric(0.005, 0.02, 0.05, 0.1)
    error = -3600.0 * np.sign(levels) * np.minimum(np.abs(levels), 0.003)
    found = diagnose([ladder(number, levels, error) for number in range(6)], MODEL)
    sizes = [abs(each.value) for one in found.effects for each in one.coefficients]
    assert sizes
    assert max(sizes) < 10 * float(np.abs(error).max())


@pytest.mark.parametrize("half_width", [0.012, 0.03])
def test_a_dead_zone_wider_than_usual_is_named(half_width: float) -> None:
    levels = symmetric(0.005, 0.01, 0.015, 0.02, 0.035, 0.05)
    error = np.where(np.abs(levels) < half_width, -3600.0 * np.array(levels), 0.0)
    found = diagnose([ladder(number, levels, error) for number in range(6)], MODEL)
    assert found.names == ("dead_zone",)
    (coefficient,) = found.effects[0].coefficients
    assert coefficient.lo <= -3600.0 <= coefficient.hi


def test_a_table_rate_that_leaks_into_another_axis_is_no_copy() -> None:
    levels = symmetric(1.0, 5.0, 10.0)
    runs = []
    for number in range(4):
        run = ladder(number, levels, np.zeros(len(levels)))
        runs.append(RunBlocks(**{**vars(run), "value": run.value - 3600.0 * 0.996 * run.mean("input_rate")}))
    residuals = residuals_of(runs, diagnose(runs, ErrorModel.parse("bias")))
    assert residuals is not None
    assert copies_of_signal(residuals, ["input_rate"]) == ()
