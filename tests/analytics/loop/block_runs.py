"""Runs of one unit as blocks of 30 s: white noise and what is added to it."""

from collections.abc import Mapping

import numpy as np

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from stream.batch import FloatArray

BLOCKS, BLOCK_S, WHITE = 80, 30.0, 0.1
UNITS = {
    "time_since_power_on": "s",
    "input_rate": "deg/s",
    "temperature": "degC",
    "supply_voltage": "V",
    "rate_y": "deg/s",
}


def run_of(
    rng: np.random.Generator, number: int, error: FloatArray, channels: Mapping[str, FloatArray], unit: str = "U1",
    sigma: FloatArray | float = WHITE,
) -> RunBlocks:  # fmt: skip
    """One run a day: the error, white noise of this standard deviation, and channels that are measured well."""
    size, spread = error.size, np.broadcast_to(np.asarray(sigma, np.float64), error.shape)
    value = 10.0 + error + spread * rng.standard_normal(size) + 0.01 * rng.standard_normal()
    measured = {name: Channel(each, np.full(size, 1e-6), UNITS[name]) for name, each in channels.items()}
    scatter = spread**2 * rng.chisquare(29, size) / 29
    day_ns, readings = number * 86_400 * 10**9, np.full(size, 30)
    return RunBlocks(
        unit, f"r{number}", "rate", np.arange(size), BLOCK_S, day_ns, value, readings, scatter, "deg/h", measured
    )


def warming(number: int) -> FloatArray:
    """A temperature that goes up and down, in each run with another period."""
    return np.asarray(25.0 + 20.0 * np.sin(np.arange(BLOCKS) / (5.0 + 0.7 * number)))
