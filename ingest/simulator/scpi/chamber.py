"""A simulated temperature chamber that speaks SCPI: a limited ramp, and air that follows it with a lag."""

from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, single, within
from ingest.simulator.scpi.timeline import Segment, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_LOWEST_DEG_C, _HIGHEST_DEG_C = -70.0, 150.0


class _Air(NamedTuple):
    air_deg_c: float
    ramp_deg_c: float
    slope_deg_c_per_s: float
    lag_s: float


class SimulatedChamber(SimulatedDevice):
    """Temperature chamber: ``TEMP:SETP``, ``TEMP:SETP?``, ``TEMP:ACT?``.

    With the controller's ramp s(t) = s0 + r t and lag T the air is s(t) - r T + (T0 - s0 + r T) exp(-t/T).

    >>> chamber = SimulatedChamber(StationClock(start_ns=0))
    >>> chamber.handle("TEMP:SETP 60")
    >>> float(chamber.temperature_deg_c(3600 * 10**9).round(6))
    60.0
    """

    def __init__(
        self, clock: StationClock, *, start_deg_c: float = 25.0, ramp_deg_c_per_min: float = 3.0, lag_s: float = 60.0
    ) -> None:
        self.setpoint_deg_c = start_deg_c
        self._slope = ramp_deg_c_per_min / 60.0
        self._lag_s = lag_s
        self.course = self._line = Timeline(clock, _Air(start_deg_c, start_deg_c, 0.0, lag_s), _air)
        queries = {
            "TEMPerature:SETPoint?": lambda: f"{self.setpoint_deg_c:.2f}",
            "TEMPerature:ACTual?": lambda: self.now(self.temperature_deg_c, 3),
        }
        super().__init__("GYROFLEET,SIMULATED CHAMBER,0,1", clock, {"TEMPerature:SETPoint": self._set}, queries)

    def temperature_deg_c(self, t_ns: IntArray | int) -> FloatArray:
        """Temperature of the air at these times of the past, degC."""
        return self._line.at(t_ns)

    def _set(self, value: float) -> None:
        target = self.setpoint_deg_c = within(value, _LOWEST_DEG_C, _HIGHEST_DEG_C)

        def plan(now_ns: int, present: _Air, dt_s: float) -> list[Segment[_Air]]:
            air = single(_air(present, np.array([dt_s])))
            ramp = present.ramp_deg_c + present.slope_deg_c_per_s * dt_s
            slope = float(np.copysign(self._slope, target - ramp))
            moving = _Air(air, ramp, slope, self._lag_s)
            end_s = abs(target - ramp) / self._slope
            at_end = _Air(single(_air(moving, np.array([end_s]))), target, 0.0, self._lag_s)
            return [Segment(now_ns, moving), Segment(now_ns + round(end_s * 1e9), at_end)]

        self._line.change(plan)


def _air(state: _Air, dt_s: FloatArray) -> FloatArray:
    behind = state.slope_deg_c_per_s * state.lag_s
    follows = (state.air_deg_c - state.ramp_deg_c + behind) * np.exp(-dt_s / state.lag_s)
    return np.asarray(state.ramp_deg_c + state.slope_deg_c_per_s * dt_s - behind + follows, np.float64)
