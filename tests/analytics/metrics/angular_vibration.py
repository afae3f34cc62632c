"""An angular-vibration table, and a gyro on it that is a first-order lag with delay."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from stream.batch import FloatArray
from tests.analytics.conftest import START_NS

RATE_HZ = 2000.0
DT_NS = 500_000
BANDWIDTH_HZ = 50.0
DELAY_S = 0.004
SCALE = 3.0  # V/(deg/s)
FREQUENCIES = [float(f"{each:.6g}") for each in np.geomspace(10, 100, 10)]
AMPLITUDE = 20.0  # deg/s
RECORD_S = 0.2


def lag(frequency_hz: float) -> complex:
    """First-order lag with delay."""
    omega = 2 * math.pi * frequency_hz
    return complex(np.exp(-1j * omega * DELAY_S) / (1 + 1j * frequency_hz / BANDWIDTH_HZ))


class Bench:
    """Records of an angular-vibration table: times in seconds from the start, rate, angle, and a gyro's output."""

    def __init__(self, seed: int = 1, noise: float = 0.0, transfer: Callable[[float], complex] = lag) -> None:
        self.rng = np.random.default_rng(seed)
        self.noise = noise
        self.transfer = transfer
        self.records: list[tuple[float, FloatArray, FloatArray]] = []
        self.t_s = 0.0

    def record(self, frequency_hz: float) -> dict[str, tuple[FloatArray, str]]:
        n = round(RECORD_S * RATE_HZ)
        t_s = self.t_s + np.arange(n) / RATE_HZ
        self.t_s += RECORD_S
        omega, start = 2 * math.pi * frequency_hz, self.rng.uniform(0, 2 * math.pi)
        turned = self.transfer(frequency_hz)
        rate = AMPLITUDE * np.sin(omega * t_s + start)
        angle = -AMPLITUDE / omega * np.cos(omega * t_s + start)
        output = SCALE * AMPLITUDE * abs(turned) * np.sin(omega * t_s + start + np.angle(turned)) + 0.3
        output += self.noise * self.rng.standard_normal(n)
        self.records.append((frequency_hz, rate, output))
        return {"rate": (output, "V"), "table_rate": (rate, "deg/s"), "table_angle": (angle, "deg")}


def fill(
    tested: Any,
    bench: Bench,
    *,
    frequencies: list[float] = FREQUENCIES,
    records: int = 10,
    signals: tuple[str, ...] = ("rate", "table_rate"),
    **words: Any,
) -> None:
    tested.run("r1", procedure="bandwidth")
    tested.mount("r1", "U1")
    t_ns = START_NS
    for frequency in frequencies:
        for repeat in range(1, records + 1):
            found = bench.record(frequency)
            t_ns = tested.step(
                "r1", "U1", {name: found[name] for name in signals}, t0_ns=t_ns, dt_ns=DT_NS,
                procedure="bandwidth", frequency_hz=frequency, repeat=repeat, **{"amplitude": AMPLITUDE, **words},
            )  # fmt: skip
