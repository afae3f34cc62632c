"""A bench that measures a unit with an output in volts step by step."""

from typing import Any

import numpy as np

from tests.analytics.conftest import START_NS


class Bench:
    """Steps of unit U1 one after the other; outputs in V at 0.02 V/(deg/s) unless another unit is named."""

    def __init__(
        self, tested: Any, run: str = "r1", *, latitude_deg: float | None = 40.0, t_ns: int = START_NS, seed: int = 7
    ):
        tested.run(run, t_ns=t_ns, latitude_deg=latitude_deg)
        tested.mount(run, "U1", product="FOG-V")
        tested.product("[product.FOG-V]\nscale_factor = 0.02\nscale_factor_unit = 'V'\n")
        self.tested, self.run, self.t_ns = tested, run, t_ns
        self.rng = np.random.default_rng(seed)

    def step(self, output: float, *, noise: float, n: int = 100, dt_ns: int = 10**8, **words: Any) -> float:
        """A step whose samples scatter about an output, V; their mean."""
        values = output + noise * self.rng.standard_normal(n)
        self.t_ns = self.tested.step(self.run, "U1", values, t0_ns=self.t_ns, dt_ns=dt_ns, unit_of_measure="V", **words)
        return float(values.mean())

    def position(self, position: str, angle: float, **words: Any) -> float:
        """Both directions of 100 deg/s in a position in which the input axis is off by an angle; delta, rad."""
        means = [
            self.step(
                0.02 * (0.003 + angle * rate), noise=1e-5, rate_command_deg_per_s=rate, position=position, **words
            )
            for rate in (100.0, -100.0)
        ]
        return (means[0] - means[1]) / (2 * 0.02 * 100.0)
