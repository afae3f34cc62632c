"""A simulated angular-vibration table that speaks SCPI: a sine whose amplitude swells, and a trace of it."""

from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, single, within
from ingest.simulator.timeline import Stretch, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_MOST_IN_TRACE = 8192


class _Sine(NamedTuple):
    angle_deg: float
    phase_rad: float
    frequency_hz: float
    amplitude_deg_per_s: float
    amplitude_at_start_deg_per_s: float
    swell_s: float


class SimulatedVibrationTable(SimulatedDevice):
    """Angular-vibration table: ``FREQ:SETP``, ``AMPL:SETP``, ``FREQ:ACT?``, ``AMPL:ACT?`` and ``RATE:TRAC?``.

    Parameters
    ----------
    clock: The station's clock, which is the trace's.
    swell_s: Time constant with which the amplitude follows what is set.
    trace_hz: Samples a second of the trace, which holds the last 8192.
    max_amplitude_deg_per_s, max_frequency_hz: What can be set.

    Notes
    -----
    rate = A(t) sin(phase + 2 pi f t), A(t) = A + (A0 - A) exp(-t/swell); the phase goes on where the frequency changes.

    Examples
    --------
    >>> table = SimulatedVibrationTable(StationClock(start_ns=0))
    >>> table.handle("AMPL:SETP 20;FREQ:SETP 50")
    >>> float(abs(table.rate_deg_per_s(3600 * 10**9 + np.arange(100_000) * 10**4)).max().round(3))
    20.0
    """

    def __init__(
        self,
        clock: StationClock,
        *,
        swell_s: float = 0.3,
        trace_hz: float = 2000.0,
        max_amplitude_deg_per_s: float = 200.0,
        max_frequency_hz: float = 1000.0,
    ) -> None:
        super().__init__(
            "GYROFLEET,SIMULATED VIBRATION TABLE,0,1",
            clock,
            {
                "FREQuency:SETPoint": lambda value: self._set(frequency_hz=within(value, 1e-3, max_frequency_hz)),
                "AMPLitude:SETPoint": lambda value: self._set(
                    amplitude_deg_per_s=within(value, 0.0, max_amplitude_deg_per_s)
                ),
            },
            {
                "FREQuency:ACTual?": lambda: f"{self.frequency_hz:.6f}",
                "AMPLitude:ACTual?": lambda: f"{single(self.amplitude_deg_per_s(clock.now_ns())):.6f}",
                "RATE:ACTual?": lambda: f"{single(self.rate_deg_per_s(clock.now_ns())):.6f}",
                "RATE:TRACe?": self._trace,
            },
        )
        self.frequency_hz = 1.0
        self.course = self._line = Timeline(clock, _Sine(0.0, 0.0, 1.0, 0.0, 0.0, swell_s), _rate)
        self._trace_dt_ns = round(1e9 / trace_hz)
        self._traced_ns = clock.now_ns()

    def rate_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Rate at these times of the past, deg/s."""
        return self._line.at(t_ns)

    def amplitude_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Amplitude of the rate at these times of the past, deg/s."""
        return self._line.at(t_ns, _amplitude)

    def angle_deg(self, t_ns: IntArray | int) -> FloatArray:
        """Angle at these times of the past, deg."""
        return self._line.at(t_ns, _angle)

    def _set(self, **changes: float) -> None:
        self.frequency_hz = changes.get("frequency_hz", self.frequency_hz)

        def plan(now_ns: int, present: _Sine, dt_s: float) -> list[Stretch[_Sine]]:
            now = np.array([dt_s])
            turned = present._replace(
                angle_deg=single(_angle(present, now)),
                phase_rad=(present.phase_rad + 2.0 * np.pi * present.frequency_hz * dt_s) % (2.0 * np.pi),
                amplitude_at_start_deg_per_s=single(_amplitude(present, now)),
            )
            return [Stretch(now_ns, turned._replace(**changes))]

        self._line.change(plan)

    def _trace(self) -> str:
        """What was measured since it was last asked: t0_ns,dt_ns,rate,rate,..."""
        dt_ns = self._trace_dt_ns
        end = self.clock.now_ns() // dt_ns
        begin = max(self._traced_ns // dt_ns + 1, end - _MOST_IN_TRACE + 1)
        self._traced_ns = end * dt_ns
        times = np.arange(begin, end + 1, dtype=np.int64) * dt_ns
        return ",".join([str(begin * dt_ns), str(dt_ns), *(f"{rate:.6f}" for rate in self.rate_deg_per_s(times))])


def _amplitude(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    behind = sine.amplitude_at_start_deg_per_s - sine.amplitude_deg_per_s
    return np.asarray(sine.amplitude_deg_per_s + behind * np.exp(-dt_s / sine.swell_s), np.float64)


def _rate(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    phase = sine.phase_rad + 2.0 * np.pi * sine.frequency_hz * dt_s
    return np.asarray(_amplitude(sine, dt_s) * np.sin(phase), np.float64)


def _angle(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    """Integrals of sin(p + w t) and exp(-t/s) sin(p + w t)."""
    omega, decay = 2.0 * np.pi * sine.frequency_hz, 1.0 / sine.swell_s
    phase = sine.phase_rad + omega * dt_s
    steady = (np.cos(sine.phase_rad) - np.cos(phase)) / omega
    swell = -(np.exp(-decay * dt_s) * (decay * np.sin(phase) + omega * np.cos(phase))) / (decay**2 + omega**2)
    swell += (decay * np.sin(sine.phase_rad) + omega * np.cos(sine.phase_rad)) / (decay**2 + omega**2)
    behind = sine.amplitude_at_start_deg_per_s - sine.amplitude_deg_per_s
    return np.asarray(sine.angle_deg + sine.amplitude_deg_per_s * steady + behind * swell, np.float64)
