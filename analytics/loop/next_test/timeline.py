"""The settings of a station during a planned test, at even instants."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analytics.loop.next_test.candidate_tests import StationBounds
from ingest.procedures.plan import PlannedStep
from stream.batch import BoolArray, FloatArray

STEP_S = 5.0


@dataclass(frozen=True)
class Timeline:
    """Settings at instants `STEP_S` apart, shape (n,).

    Parameters
    ----------
    setpoint_deg_c: Set-point of the chamber, NaN before it is first set.
    air_deg_c: Limited by the slope of the chamber, NaN where the set-point is.
    rate_deg_per_s: Of the table.
    since_power_on_s: NaN without power.
    position, volts: Of the step, empty or NaN where it says nothing.
    """

    setpoint_deg_c: FloatArray
    air_deg_c: FloatArray
    rate_deg_per_s: FloatArray
    since_power_on_s: FloatArray
    position: tuple[str, ...]
    volts: FloatArray

    @property
    def time_s(self) -> FloatArray:
        """Instants from the start."""
        return np.asarray((np.arange(self.rate_deg_per_s.size) + 0.5) * STEP_S)

    @property
    def is_powered(self) -> BoolArray:
        """Whether the unit gives samples."""
        return np.isfinite(self.since_power_on_s)


def timeline(steps: Sequence[PlannedStep], bounds: StationBounds, start_deg_c: float) -> Timeline:
    """Play the steps of a test; the unit is powered on at its start, in a chamber at `start_deg_c`."""
    setpoint, rate, since, position, volts = np.nan, 0.0, 0.0, "", np.nan
    air, moving = start_deg_c, 0.0
    rows: list[tuple[float, float, float, float, str, float]] = []

    def play(seconds: float, *, powered: bool = True) -> None:
        nonlocal air, since, moving
        for _ in range(round(seconds / STEP_S)):
            if np.isfinite(setpoint):
                most = bounds.slope_deg_c_per_min / 60.0 * STEP_S
                air += float(np.clip(setpoint - air, -most, most))
            most = bounds.acceleration_deg_per_s2 * STEP_S
            moving += float(np.clip(rate - moving, -most, most))
            since = since + STEP_S if powered else -STEP_S
            rows.append((setpoint, air, moving, since if powered else np.nan, position, volts))

    for step in steps:
        if step.power in ("off", "cycle"):
            play(step.off_s, powered=False)
        setpoint = step.settings.get("temperature", setpoint)
        rate = step.settings.get("rate", rate)
        position = step.words.position or position
        volts = _volts(step.words.step or "", volts)
        if "temperature" in step.wait_settled and np.isfinite(setpoint):
            play(abs(setpoint - air) / (bounds.slope_deg_c_per_min / 60.0))
        play(step.warm_up_s + step.settle_s + step.record_s)
    columns = list(zip(*rows, strict=True))
    setpoints, airs, rates, powered = (np.array(columns[each], dtype=np.float64) for each in range(4))
    airs[np.isnan(setpoints)] = np.nan
    return Timeline(setpoints, airs, rates, powered, tuple(columns[4]), np.array(columns[5], dtype=np.float64))


def _volts(name: str, before: float) -> float:
    """Volts of a step that an operator sets, ``supply 12 V``."""
    words = name.split()
    return float(words[1]) if len(words) == 3 and words[0] == "supply" else before
