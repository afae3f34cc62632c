"""The chamber of simulated gyros: a first-order approach, a daily sine, and a draught at each gyro."""

import math

import msgspec
import numpy as np

from ingest.simulator.noise import ornstein_uhlenbeck
from stream.batch import FloatArray
from stream.errors import BadInput

TEMPERATURE_INTERVAL_NS = 1_000_000_000


def check_numbers(
    who: str, parameters: msgspec.Struct, not_negative: tuple[str, ...], positive: tuple[str, ...]
) -> None:
    """Refuse parameters that are not finite or have an impossible sign.

    Raises
    ------
    BadInput: Naming the parameter.
    """
    for name, value in msgspec.structs.asdict(parameters).items():
        if isinstance(value, str):
            continue
        if not math.isfinite(value):
            raise BadInput(f"{who}: {name} is {value}, a finite number is needed")
        if name in not_negative and value < 0:
            raise BadInput(f"{who}: {name} is {value}, at least 0 is needed")
        if name in positive and value <= 0:
            raise BadInput(f"{who}: {name} is {value}, more than 0 is needed")


class ChamberParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Temperature of a chamber, and of the thermometer on each gyro in it.

    Parameters
    ----------
    mean_deg_c: Temperature it settles at.
    start_offset_deg_c, settling_time_constant_s: Where it starts, relative to that, and the time constant of the
        first-order approach.
    daily_amplitude_deg_c, daily_period_s: Sine on top, 0 and rising at the start.
    draught_deg_c, draught_correlation_s: Standard deviation and correlation time of the local fluctuation at each gyro.
    thermometer_noise_deg_c: Standard deviation of one reading. Readings are rounded to 0.01 degC.

    Raises
    ------
    BadInput: If a number has an impossible sign or is not finite.
    """

    mean_deg_c: float = 25.5
    start_offset_deg_c: float = -2.0
    settling_time_constant_s: float = 2400.0
    daily_amplitude_deg_c: float = 1.0
    daily_period_s: float = 86400.0
    draught_deg_c: float = 0.03
    draught_correlation_s: float = 600.0
    thermometer_noise_deg_c: float = 0.01

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(
            "simulated chamber",
            self,
            not_negative=("draught_deg_c", "thermometer_noise_deg_c"),
            positive=("settling_time_constant_s", "daily_period_s", "draught_correlation_s"),
        )


class GyroTemperature:
    """True temperature at one gyro.

    Two of them made from one seed run through the same temperatures, each at its own pace: the rate and the
    readings of a gyro can be drawn in any order without keeping what the other has not yet reached.

    Parameters
    ----------
    chamber: The chamber.
    seed: Of the draught.
    """

    def __init__(self, chamber: ChamberParameters, seed: np.random.SeedSequence) -> None:
        self._chamber = chamber
        self._draught = ornstein_uhlenbeck(
            np.array([chamber.draught_deg_c]),
            np.array([chamber.draught_correlation_s]),
            TEMPERATURE_INTERVAL_NS * 1e-9,
            np.random.default_rng(seed),
        )
        self._next_s = 0
        self._nodes = np.empty(0)

    def seconds(self, n: int) -> FloatArray:
        """Return the temperature at the next `n` whole seconds, degC."""
        c = self._chamber
        t_s = self._next_s + np.arange(n, dtype=np.float64)
        self._next_s += n
        settling = c.start_offset_deg_c * np.exp(-t_s / c.settling_time_constant_s)
        daily = c.daily_amplitude_deg_c * np.sin(2 * np.pi * t_s / c.daily_period_s)
        return c.mean_deg_c + settling + daily + self._draught.means(n)

    def at(self, t_s: FloatArray) -> FloatArray:
        """Temperature at times after those of the call before, linear between whole seconds, degC."""
        needed = int(t_s[-1]) + 2
        if needed > self._next_s:
            self._nodes = np.concatenate([self._nodes, self.seconds(needed - self._next_s)])
        first = self._next_s - len(self._nodes)
        temperature = np.interp(t_s, np.arange(first, self._next_s), self._nodes)
        self._nodes = self._nodes[int(t_s[-1]) - first :]
        return temperature
