"""A simulated digital voltmeter that speaks SCPI, and what it is connected to."""

from collections.abc import Callable

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, within
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_OVERLOAD = "+9.90000000E+37"
_MAINS_HZ = 50.0
_POINTS = 16  # of the mean over its averaging time
_DIGITS = 1.2e6  # 6.5 digits: a range of 10 V reads to 12 V in steps of 10 uV


class SimulatedVoltmeter(SimulatedDevice):
    """Digital voltmeter: ``CONF:VOLT:DC``, ``VOLT:DC:NPLC``, ``READ?``; it waits while it averages, as real ones do.

    Parameters
    ----------
    clock: The station's clock.
    source_v: Voltage at its input at times, V, shape (n,); by default 1 V.
    noise_v: Standard deviation of a reading of 1 NPLC, V; it falls with the root of the averaging time.
    seed: Of the noise.

    Examples
    --------
    >>> voltmeter = SimulatedVoltmeter(StationClock(speed=1000.0), noise_v=0.0)
    >>> voltmeter.handle("CONF:VOLT:DC 10;:VOLT:DC:NPLC 10")
    >>> voltmeter.handle("READ?")
    '+1.00000000E+00'
    """

    def __init__(
        self,
        clock: StationClock,
        *,
        source_v: Callable[[IntArray], FloatArray] = lambda t_ns: np.ones(len(t_ns)),
        noise_v: float = 1e-6,
        seed: int = 1,
    ) -> None:
        super().__init__(
            "GYROFLEET,SIMULATED VOLTMETER,0,1",
            clock,
            {"CONFigure[:VOLTage][:DC]": self._configure, "[SENSe:]VOLTage[:DC]:NPLCycles": self._average},
            {
                "READ?": self._measure,
                "[SENSe:]VOLTage[:DC]:NPLCycles?": lambda: f"{self.nplc:g}",
                "[SENSe:]VOLTage[:DC]:RANGe?": lambda: f"{self.range_v:g}",
            },
        )
        self.range_v = 10.0
        self.nplc = 1.0
        self.source_v = source_v
        self._noise_v = noise_v
        self._random = np.random.default_rng(seed)

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
