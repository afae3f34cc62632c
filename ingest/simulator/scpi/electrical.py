"""Simulated electrical instruments that speak SCPI: a power supply with a resistive load, and a digital voltmeter."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, single, within
from ingest.simulator.scpi.timeline import Segment, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_MAX_VOLTAGE_V, _MAX_CURRENT_A = 36.0, 10.0
_LOAD_OHM = 10.0
_RISE_S = 0.02  # time constant of the voltage
_OVERLOAD = "+9.90000000E+37"
_MAINS_HZ = 50.0
_POINTS = 16  # of the mean over its averaging time
_DIGITS = 1.2e6  # 6.5 digits: a range of 10 V reads to 12 V in steps of 10 uV


class _Output(NamedTuple):
    set_v: float
    limit_a: float
    on: float
    at_start_v: float


class SimulatedSupply(SimulatedDevice):
    """Power supply of a resistor: ``VOLT``, ``CURR``, ``OUTP``, their queries, ``MEAS:VOLT?``, ``MEAS:CURR?``."""

    def __init__(self, clock: StationClock) -> None:
        self.course = self._line = Timeline(clock, _Output(0.0, _MAX_CURRENT_A, 0.0, 0.0), self._voltage)
        settings = {
            "[SOURce:]VOLTage": lambda value: self._set(set_v=within(value, 0.0, _MAX_VOLTAGE_V)),
            "[SOURce:]CURRent": lambda value: self._set(limit_a=within(value, 0.0, _MAX_CURRENT_A)),
            "OUTPut[:STATe]": lambda value: self._set(on=float(within(value, 0.0, 1.0) != 0.0)),
        }
        queries = {
            "[SOURce:]VOLTage?": lambda: f"{self._line.now.set_v:.4f}",
            "[SOURce:]CURRent?": lambda: f"{self._line.now.limit_a:.4f}",
            "OUTPut[:STATe]?": lambda: f"{self._line.now.on:.0f}",
            "MEASure:VOLTage?": lambda: self.now(self.voltage_v, 4),
            "MEASure:CURRent?": lambda: self.now(self.current_a, 4),
        }
        super().__init__("GYROFLEET,SIMULATED SUPPLY,0,1", clock, settings, queries)

    def voltage_v(self, t_ns: IntArray | int) -> FloatArray:
        """Voltage at the load at these times of the past, V."""
        return self._line.at(t_ns)

    def current_a(self, t_ns: IntArray | int) -> FloatArray:
        """Current through the load at these times of the past, A."""
        return np.asarray(self.voltage_v(t_ns) / _LOAD_OHM, np.float64)

    def is_on(self, t_ns: IntArray | int) -> FloatArray:
        """1 where the output was on at these times of the past, else 0."""
        return self._line.at(t_ns, lambda state, dt_s: np.full(dt_s.shape, state.on))

    def _set(self, **changes: float) -> None:
        def plan(now_ns: int, present: _Output, dt_s: float) -> list[Segment[_Output]]:
            at_start_v = single(self._voltage(present, np.array([dt_s])))
            return [Segment(now_ns, present._replace(at_start_v=at_start_v, **changes))]

        self._line.change(plan)

    def _voltage(self, state: _Output, dt_s: FloatArray) -> FloatArray:
        target = min(state.set_v, state.limit_a * _LOAD_OHM) if state.on else 0.0
        return np.asarray(target + (state.at_start_v - target) * np.exp(-dt_s / _RISE_S), np.float64)


class SimulatedVoltmeter(SimulatedDevice):
    """Digital voltmeter: ``CONF:VOLT:DC``, ``VOLT:DC:NPLC``, ``READ?``; a reading takes the averaging time.

    `source_v`: voltage at its input at times, V, shape (n,); by default 1 V.
    `noise_v`: standard deviation of a reading of 1 NPLC, V; it falls with the root of the averaging time.
    """

    def __init__(
        self, clock: StationClock, *, source_v: Callable[[IntArray], FloatArray] = lambda t_ns: np.ones(len(t_ns)),
        noise_v: float = 1e-6,
    ) -> None:  # fmt: skip
        self.range_v, self.nplc = 10.0, 1.0
        settings = {"CONFigure[:VOLTage][:DC]": self._configure, "[SENSe:]VOLTage[:DC]:NPLCycles": self._average}
        queries = {
            "READ?": self._measure,
            "[SENSe:]VOLTage[:DC]:NPLCycles?": lambda: f"{self.nplc:g}",
            "[SENSe:]VOLTage[:DC]:RANGe?": lambda: f"{self.range_v:g}",
        }
        super().__init__("GYROFLEET,SIMULATED VOLTMETER,0,1", clock, settings, queries)
        self.source_v, self._noise_v = source_v, noise_v
        self._random = np.random.default_rng(1)

    def _configure(self, value: float) -> None:
        self.range_v = within(value, 1e-3, 1000.0)

    def _average(self, value: float) -> None:
        self.nplc = within(value, 0.02, 100.0)

    def _measure(self) -> str:
        average_s = self.nplc / _MAINS_HZ
        start_ns = self.clock.now_ns()
        self.clock.sleep(average_s)
        middles = start_ns + ((np.arange(_POINTS) + 0.5) / _POINTS * average_s * 1e9).astype(np.int64)
        value = float(self.source_v(middles).mean() + self._noise_v / self.nplc**0.5 * self._random.standard_normal())
        step = 12.0 * self.range_v / 10.0 / _DIGITS
        return _OVERLOAD if abs(value) > 1.2 * self.range_v else f"{round(value / step) * step:+.8E}"
