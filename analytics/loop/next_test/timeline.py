"""The settings of a station during a planned test, at even instants."""

from dataclasses import dataclass

import numpy as np

from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.station_bounds import StationBounds
from stream.batch import BoolArray, FloatArray

STEP_S = 5.0
_PROMPT_S = 300.0  # as `gyrofleet procedure estimate-time` has it


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
    prompts: Actions of an operator.
    """

    setpoint_deg_c: FloatArray
    air_deg_c: FloatArray
    rate_deg_per_s: FloatArray
    since_power_on_s: FloatArray
    position: tuple[str, ...]
    volts: FloatArray
    prompts: int = 0

    @property
    def time_s(self) -> FloatArray:
        """Instants from the start."""
        return np.asarray((np.arange(self.rate_deg_per_s.size) + 0.5) * STEP_S)

    @property
    def hours(self) -> float:
        """Duration, with the time of the operator."""
        return (self.rate_deg_per_s.size * STEP_S + self.prompts * _PROMPT_S) / 3600.0

    @property
    def is_powered(self) -> BoolArray:
        """Whether the unit gives samples."""
        return np.isfinite(self.since_power_on_s)


def timeline(test: CandidateTest, bounds: StationBounds) -> Timeline:
    """Play the steps of a test; the unit is powered on at its start, in a chamber at the middle of its bounds."""
    parts: list[tuple[FloatArray, ...]] = []
    positions: list[str] = []
    setpoint, rate, volts, position = np.nan, 0.0, np.nan, ""
    air, moving, since = bounds.middle_deg_c, 0.0, 0.0
    most_deg_c, most_rate = bounds.slope_deg_c_per_min / 60.0 * STEP_S, bounds.acceleration_deg_per_s2 * STEP_S

    def play(seconds: float, *, powered: bool = True) -> None:
        nonlocal air, moving, since
        count = np.arange(1.0, round(seconds / STEP_S) + 1.0)
        if not count.size:
            return
        known = np.isfinite(setpoint)
        heated = _towards(air, setpoint, most_deg_c * count) if known else np.full(count.size, np.nan)
        turned = _towards(moving, rate, most_rate * count)
        on = since + STEP_S * count if powered else np.full(count.size, np.nan)
        held = np.ones(count.size)
        parts.append((setpoint * held, heated, turned, on, volts * held))
        positions.extend([position] * count.size)
        air, moving, since = (heated[-1] if known else air), turned[-1], (on[-1] if powered else -STEP_S)

    steps = test.planned()
    for number, step in enumerate(steps):
        if step.power in ("off", "cycle"):
            play(step.off_s, powered=False)
        setpoint = step.settings.get("temperature", setpoint)
        rate = step.settings.get("rate", rate)
        position = step.words.position or position
        volts = test.volts[number] if test.volts else np.nan
        if "temperature" in step.wait_settled and np.isfinite(setpoint):
            play(abs(setpoint - air) / (bounds.slope_deg_c_per_min / 60.0))
        play(step.warm_up_s + step.settle_s + step.record_s)
    setpoints, airs, rates, powered, supplied = map(np.concatenate, zip(*parts, strict=True))
    prompts = sum(step.prompt is not None for step in steps)
    return Timeline(setpoints, airs, rates, powered, tuple(positions), supplied, prompts)


def _towards(start: float, target: float, most: FloatArray) -> FloatArray:
    """From a start towards a target, no farther than `most`."""
    return np.asarray(start + np.clip(target - start, -most, most))
