"""A simulated power supply that speaks SCPI, with a load of so many ohms on it."""

from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, single, within
from ingest.simulator.timeline import Stretch, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray


class _Output(NamedTuple):
    set_v: float
    limit_a: float
    on: float
    at_start_v: float


class SimulatedSupply(SimulatedDevice):
    """Power supply: ``VOLT``, ``CURR``, ``OUTP``, their queries, ``MEAS:VOLT?`` and ``MEAS:CURR?``.

    Parameters
    ----------
    clock: The station's clock.
    load_ohm: What hangs on it.
    rise_s: Time constant with which the voltage follows.
    max_voltage_v, max_current_a: What can be set.

    Examples
    --------
    >>> supply = SimulatedSupply(StationClock(start_ns=0), load_ohm=5.0)
    >>> supply.handle("VOLT 5;CURR 2;OUTP ON")
    >>> float(supply.voltage_v(3600 * 10**9)), float(supply.current_a(3600 * 10**9))
    (5.0, 1.0)
    """

    def __init__(
        self,
        clock: StationClock,
        *,
        load_ohm: float = 10.0,
        rise_s: float = 0.02,
        max_voltage_v: float = 36.0,
        max_current_a: float = 10.0,
    ) -> None:
        super().__init__(
            "GYROFLEET,SIMULATED SUPPLY,0,1",
            clock,
            {
                "[SOURce:]VOLTage": lambda value: self._set(set_v=within(value, 0.0, max_voltage_v)),
                "[SOURce:]CURRent": lambda value: self._set(limit_a=within(value, 0.0, max_current_a)),
                "OUTPut[:STATe]": lambda value: self._set(on=float(within(value, 0.0, 1.0) != 0.0)),
            },
            {
                "[SOURce:]VOLTage?": lambda: f"{self._line.now.set_v:.4f}",
                "[SOURce:]CURRent?": lambda: f"{self._line.now.limit_a:.4f}",
                "OUTPut[:STATe]?": lambda: f"{self._line.now.on:.0f}",
                "MEASure:VOLTage?": lambda: f"{single(self.voltage_v(clock.now_ns())):.4f}",
                "MEASure:CURRent?": lambda: f"{single(self.current_a(clock.now_ns())):.4f}",
            },
        )
        self._load_ohm = load_ohm
        self._rise_s = rise_s
        self.course = self._line = Timeline(clock, _Output(0.0, max_current_a, 0.0, 0.0), self._voltage)

    def voltage_v(self, t_ns: IntArray | int) -> FloatArray:
        """Voltage at the load at these times of the past, V."""
        return self._line.at(t_ns)

    def current_a(self, t_ns: IntArray | int) -> FloatArray:
        """Current through the load at these times of the past, A."""
        return np.asarray(self.voltage_v(t_ns) / self._load_ohm, np.float64)

    def is_on(self, t_ns: IntArray | int) -> FloatArray:
        """1 where the output was on at these times of the past, else 0."""
        return self._line.at(t_ns, lambda state, dt_s: np.full(dt_s.shape, state.on))

    def _set(self, **changes: float) -> None:
        def plan(now_ns: int, present: _Output, dt_s: float) -> list[Stretch[_Output]]:
            at_start_v = single(self._voltage(present, np.array([dt_s])))
            return [Stretch(now_ns, present._replace(at_start_v=at_start_v, **changes))]

        self._line.change(plan)

    def _voltage(self, state: _Output, dt_s: FloatArray) -> FloatArray:
        target = min(state.set_v, state.limit_a * self._load_ohm) if state.on else 0.0
        return np.asarray(target + (state.at_start_v - target) * np.exp(-dt_s / self._rise_s), np.float64)
