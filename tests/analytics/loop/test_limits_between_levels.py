"""A limit between two rates at which a table stands is known to lie between these, and no better."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.diagnosis import diagnose

WHITE = 0.05


def stepped(limit_deg_per_s: float, number: int, rng: np.random.Generator) -> RunBlocks:
    """A run of rates held one after the other, of a gyro that does not go beyond a limit."""
    rate = np.repeat([0.0, 25.0, -25.0, 50.0, -50.0, 75.0, -75.0, 100.0, -100.0, 0.0], 6)
    slots = 10 * np.arange(10).repeat(6) + np.tile(np.arange(6), 10)  # ramps between are left out
    one = np.ones(rate.size)
    value = 10.0 + 3600.0 * np.clip(rate, -limit_deg_per_s, limit_deg_per_s) + WHITE * rng.standard_normal(rate.size)
    return RunBlocks(
        "U1", f"r{number}", "rate", slots, 10.0, number * 86_400 * 10**9, value, 100 * one.astype(int),
        WHITE**2 * one, "deg/h", {"input_rate": Channel(rate, 1e-6 * one, "deg/s")},
    )  # fmt: skip


@pytest.mark.parametrize("limit", [77.0, 87.0, 93.0])
def test_a_limit_between_two_rates_has_these_as_bounds(limit: float) -> None:
    rng = np.random.default_rng(int(limit))
    found = diagnose(
        [stepped(limit, number, rng) for number in range(6)], ErrorModel.parse("rate = bias + scale_factor*input_rate")
    )
    (saturation,) = (each for each in found.effects if each.name == "saturation")
    ((low, high),) = saturation.parameter_bounds.values()
    assert 74.0 < low <= 77.0
    assert 93.0 <= high <= 100.0
    (size,) = saturation.coefficients
    assert size.lo < -3600.0 < size.hi < 0.0
