"""A rate table on which the tests of the scale-factor family measure a unit."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tests.analytics.conftest import START_NS

RATES = (4.0, 6.3, 10.0, 16.0, 25.0, 40.0, 63.0, 100.0, 160.0, 250.0, 300.0)
BOTH = tuple(sign * rate for rate in RATES for sign in (1, -1))
Gyro = Callable[[float], float]


class Table:
    """A rate table on which one unit is measured; keeps the raw samples of each step."""

    def __init__(self, tested: Any, run: str, gyro: Gyro, *, seed: int = 1, unit: str = "deg/s", t_ns: int = START_NS):
        self.tested, self.run, self.gyro, self.unit, self.t_ns = tested, run, gyro, unit, t_ns
        self.rng = np.random.default_rng(seed)
        self.samples: list[tuple[float, np.ndarray]] = []

    def step(self, rate: float, *, noise: float | None = None, **words: Any) -> np.ndarray:
        deviation = noise or (1e-5 if self.unit == "V" else 1e-3)
        values = self.gyro(rate) + deviation * self.rng.standard_normal(100)
        self.t_ns = self.tested.step(
            self.run, "U1", values, t0_ns=self.t_ns, unit_of_measure=self.unit,
            rate_command_deg_per_s=rate, **words,
        )  # fmt: skip
        self.samples.append((rate, values))
        return values

    def rates(
        self, rates: Sequence[float] = BOTH, *, rests: bool = True, **words: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rest, rates and rest; the rates and the mean outputs, the rests first and last."""
        every = [0.0, *rates, 0.0] if rests else list(rates)
        names = ["rest_before", *["rate"] * len(rates), "rest_after"] if rests else ["rate"] * len(rates)
        means = [self.step(rate, step=name, **words).mean() for rate, name in zip(every, names, strict=True)]
        return np.array(every), np.array(means)


def cubic(rate: float) -> float:
    """Output of a gyro, V: scale factor, zero, asymmetry and a cubic."""
    return 0.02 * rate * (1 + 30e-6 * (rate > 0)) + 0.005 + 0.02 * 300 * 50e-6 * (rate / 300) ** 3


def by_standard(rows: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {row["standard"]: row for row in rows}
