"""The settings of a station during a planned test, at even instants."""

from dataclasses import dataclass

import numpy as np

from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.station_bounds import StationBounds
from stream.batch import BoolArray, FloatArray, IntArray

STEP_S = 5.0
SLEW_DEG_PER_S = 10.0  # of a table that goes to an angle
_PROMPT_S = 300.0  # as `gyrofleet procedure estimate-time` has it


@dataclass(frozen=True)
class Timeline:
    """Settings at instants `STEP_S` apart, shape (n,).

    Parameters
    ----------
    setpoint_deg_c: Set-point of the chamber, NaN before it is first set.
    air_deg_c: Limited by the slope of the chamber, NaN where the set-point is.
    rate_deg_per_s: Of the table.
    angle_deg: Turned from where the table stood at first; NaN throughout if it is never sent to an angle.
    since_power_on_s: NaN without power.
    power_on: Number of the power-on, from 0.
    position, volts: Of the step, empty or NaN where it says nothing.
    prompts: Actions of an operator.
    """

    setpoint_deg_c: FloatArray
    air_deg_c: FloatArray
    rate_deg_per_s: FloatArray
    angle_deg: FloatArray
    since_power_on_s: FloatArray
    power_on: IntArray
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
    player = _Player(bounds)
    steps = test.planned()
    for number, step in enumerate(steps):
        if step.power in ("off", "cycle"):
            player.play(step.off_s, is_powered=False)
        player.position = step.words.position or player.position
        player.volts = test.volts[number] if test.volts else np.nan
        if "angle" in step.settings:
            player.turn_to(step.settings["angle"])
        player.setpoint = step.settings.get("temperature", player.setpoint)
        player.rate = step.settings.get("rate", 0.0 if "angle" in step.settings else player.rate)
        if "temperature" in step.wait_settled:
            player.wait_for_the_chamber()
        player.play(step.warm_up_s + step.settle_s + step.record_s)
    return player.timeline(sum(step.prompt is not None for step in steps))


class _Player:
    """Chamber, table and power while the steps are played."""

    def __init__(self, bounds: StationBounds) -> None:
        self._most_deg_c = bounds.slope_deg_c_per_min / 60.0 * STEP_S
        self._most_rate = bounds.acceleration_deg_per_s2 * STEP_S
        self._slew = min(SLEW_DEG_PER_S, bounds.rate_deg_per_s or SLEW_DEG_PER_S)
        self.setpoint, self.rate, self.volts, self.position = np.nan, 0.0, np.nan, ""
        self._air, self._moving, self._angle, self._since = bounds.middle_deg_c, 0.0, 0.0, 0.0
        self._power_on = 0
        self._is_at_angles = False
        self._parts: list[tuple[FloatArray, ...]] = []
        self._positions: list[str] = []

    def turn_to(self, angle: float) -> None:
        """Send the table to an angle; it then rests there."""
        self._is_at_angles = True
        self.rate = 0.0
        if (apart := angle - self._angle) != 0.0:
            count = max(1, int(np.ceil(abs(apart) / self._slew / STEP_S)))
            self._add(np.full(count, apart / (count * STEP_S)), is_powered=True)
            self._angle = angle
        self._moving = 0.0

    def wait_for_the_chamber(self) -> None:
        """Wait until the air has the temperature that is set."""
        if np.isfinite(self.setpoint):
            self.play(abs(self.setpoint - self._air) / self._most_deg_c * STEP_S)

    def play(self, seconds: float, *, is_powered: bool = True) -> None:
        """Let the time pass."""
        count = np.arange(1.0, round(seconds / STEP_S) + 1.0)
        if count.size:
            self._add(_towards(self._moving, self.rate, self._most_rate * count), is_powered=is_powered)

    def _add(self, turned: FloatArray, *, is_powered: bool) -> None:
        count = np.arange(1.0, turned.size + 1.0)
        heated = np.full(turned.size, np.nan)
        if np.isfinite(self.setpoint):
            heated = _towards(self._air, self.setpoint, self._most_deg_c * count)
            self._air = float(heated[-1])
        angle = self._angle + np.cumsum(turned) * STEP_S
        on = self._since + STEP_S * count if is_powered else np.full(turned.size, np.nan)
        if not is_powered:
            self._power_on += 1
        held = np.ones(turned.size)
        self._parts.append((self.setpoint * held, heated, turned, angle, on, self._power_on * held, self.volts * held))
        self._positions.extend([self.position] * turned.size)
        self._moving, self._angle = float(turned[-1]), float(angle[-1])
        self._since = float(on[-1]) if is_powered else -STEP_S

    def timeline(self, prompts: int) -> Timeline:
        """All that was played."""
        setpoints, airs, rates, angles, powered, number, volts = map(np.concatenate, zip(*self._parts, strict=True))
        if not self._is_at_angles:
            angles = np.full(rates.size, np.nan)
        power_on = number.astype(np.int64)
        return Timeline(setpoints, airs, rates, angles, powered, power_on, tuple(self._positions), volts, prompts)


def _towards(start: float, target: float, most: FloatArray) -> FloatArray:
    """From a start towards a target, no farther than `most`."""
    return np.asarray(start + np.clip(target - start, -most, most))
