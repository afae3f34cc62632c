"""Simulated gyros with chosen parts, and their rates in counts and in deg/h."""

from typing import Any

import numpy as np

from ingest.simulator.physics.gyro import GyroParameters
from ingest.simulator.physics.mounting import ChamberParameters
from ingest.simulator.physics.plan import Plan
from ingest.simulator.physics.scale import Scale
from ingest.simulator.station import PoweredUnit
from stream.batch import FloatArray

FINE = 1e-9
STILL = ChamberParameters(
    mean_deg_c=25, start_offset_deg_c=0, daily_amplitude_deg_c=0, draught_deg_c=0, thermometer_noise_deg_c=0
)


def powered(
    parameters: GyroParameters, seed: int = 1, chamber: ChamberParameters | None = None, unit: str = "FOG-1"
) -> PoweredUnit:
    return PoweredUnit(Plan(seed, {unit: parameters}), unit, chamber=chamber)


def of_scale(deg_per_s_per_count: float, **groups: Any) -> GyroParameters:
    given: dict[str, Any] = {"hold_s": 0.1, "scale": Scale(counts_per_deg_per_s=1 / deg_per_s_per_count)}
    return GyroParameters(**given | groups)


def rate_deg_per_h(parameters: GyroParameters, n: int, seed: int) -> FloatArray:
    counts = powered(parameters, seed, STILL).rate_counts(n)
    return counts.astype(np.float64) * (3600 / parameters.scale.counts_per_deg_per_s)
