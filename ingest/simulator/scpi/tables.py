"""Simulated tables that speak SCPI: a single-axis rate table and an angular-vibration table."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import Refused, SimulatedDevice, single, within
from ingest.simulator.scpi.timeline import Segment, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_MAX_RATE_DEG_PER_S = 400.0
_ACCELERATION_DEG_PER_S2 = 100.0
_POSITIONING_RATE_DEG_PER_S = 30.0
_RIPPLE_RAD_PER_S = 2.0 * np.pi * 7.0
_MAX_AMPLITUDE_DEG_PER_S = 200.0
_MAX_FREQUENCY_HZ = 1000.0
_SWELL_S = 0.3  # time constant with which the amplitude follows its setting
_TRACE_DT_NS = 500_000
_MOST_IN_TRACE = 8192


class _Motion(NamedTuple):
    angle_deg: float
    rate_deg_per_s: float
    acceleration_deg_per_s2: float
    ripple_deg_per_s: float
    position: str = ""  # the one that the units are carried to; empty for that of the station


class SimulatedRateTable(SimulatedDevice):
    """Rate table: ``RATE:SETP``, ``ANGL:SETP``, ``RATE:ACT?``, ``ANGL:ACT?``; ``POS`` carries the units to a position.

    Segments of constant acceleration, with a ripple on the rate while it turns; the angle is the exact integral of the
    rate, ripple included, and is not reduced to one turn.
    """

    def __init__(self, clock: StationClock, *, ripple_deg_per_s: float = 2e-4, positions: Sequence[str] = ()) -> None:
        queries = {
            "RATE:ACTual?": lambda: self.now(self.rate_deg_per_s, 6),
            "ANGLe:ACTual?": lambda: self.now(self.angle_deg, 6),
        }
        settings = {"RATE:SETPoint": self._set_rate, "ANGLe:SETPoint": self._set_angle}
        words = {"POSition": self.carry}
        super().__init__("GYROFLEET,SIMULATED RATE TABLE,0,1", clock, settings, queries, words)
        self._ripple_deg_per_s = ripple_deg_per_s
        self._positions = frozenset(positions)
        self.course = self._line = Timeline(clock, _Motion(0.0, 0.0, 0.0, 0.0), _rate)

    def rate_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Rate at these times of the past, deg/s."""
        return self._line.at(t_ns)

    def angle_deg(self, t_ns: IntArray | int) -> FloatArray:
        """Angle at these times of the past, deg, over several turns."""
        return self._line.at(t_ns, _angle)

    def positions(self, t_ns: IntArray) -> tuple[tuple[str, ...], IntArray]:
        """Names of the positions at these times of the past, and the index of each time's name in them."""
        names: list[str] = []

        def index(motion: _Motion, dt_s: FloatArray) -> FloatArray:
            if motion.position not in names:
                names.append(motion.position)
            return np.full(dt_s.shape, float(names.index(motion.position)))

        which = self._line.at(t_ns, index)
        return tuple(names), which.astype(np.int64)

    def carry(self, position: str) -> None:
        """Carry the units to a position at once; the table comes to rest."""
        if position not in self._positions:
            raise Refused(f'-224,"Illegal parameter value;no position {position}"')
        self._move(lambda motion: [_to_rate(motion.rate_deg_per_s, 0.0)], 0.0, position=position)

    def _set_rate(self, value: float) -> None:
        target = within(value, -_MAX_RATE_DEG_PER_S, _MAX_RATE_DEG_PER_S)
        self._move(lambda motion: [_to_rate(motion.rate_deg_per_s, target)], target)

    def _set_angle(self, value: float) -> None:
        a = _ACCELERATION_DEG_PER_S2

        def legs(motion: _Motion) -> list[tuple[float, float]]:
            stop = _to_rate(motion.rate_deg_per_s, 0.0)
            way = value - (motion.angle_deg + motion.rate_deg_per_s * stop[0] / 2.0)
            peak = min(_POSITIONING_RATE_DEG_PER_S, math.sqrt(a * abs(way)))
            up = math.copysign(a, way)
            level_s = max(0.0, abs(way) - peak**2 / a) / peak if peak else 0.0
            return [stop, (peak / a, up), (level_s, 0.0), (peak / a, -up)]

        self._move(legs, 0.0, value)

    def _move(
        self, legs: Callable[[_Motion], list[tuple[float, float]]], rate: float, angle: float | None = None,
        position: str | None = None,
    ) -> None:  # fmt: skip
        def plan(now_ns: int, present: _Motion, dt_s: float) -> list[Segment[_Motion]]:
            motion = _after(present, dt_s)
            if position is not None:
                motion = motion._replace(position=position)
            t_ns, segments = now_ns, []
            for duration_s, acceleration in legs(motion):
                if duration_s <= 0.0:
                    continue
                motion = motion._replace(acceleration_deg_per_s2=acceleration, ripple_deg_per_s=0.0)
                segments.append(Segment(t_ns, motion))
                motion = _after(motion, duration_s)
                t_ns += round(duration_s * 1e9)
            end = motion.angle_deg if angle is None else angle
            ripple = self._ripple_deg_per_s if rate else 0.0
            segments.append(Segment(t_ns, _Motion(end, rate, 0.0, ripple, motion.position)))
            return segments

        self._line.change(plan)


def _to_rate(rate: float, target: float) -> tuple[float, float]:
    """Seconds, and acceleration, from one rate to another."""
    change = target - rate
    return abs(change) / _ACCELERATION_DEG_PER_S2, math.copysign(_ACCELERATION_DEG_PER_S2, change)


def _rate(motion: _Motion, dt_s: FloatArray) -> FloatArray:
    ripple = motion.ripple_deg_per_s * np.sin(_RIPPLE_RAD_PER_S * dt_s)
    return np.asarray(motion.rate_deg_per_s + motion.acceleration_deg_per_s2 * dt_s + ripple, np.float64)


def _angle(motion: _Motion, dt_s: FloatArray) -> FloatArray:
    ripple = motion.ripple_deg_per_s * (1.0 - np.cos(_RIPPLE_RAD_PER_S * dt_s)) / _RIPPLE_RAD_PER_S
    steady = motion.rate_deg_per_s * dt_s + 0.5 * motion.acceleration_deg_per_s2 * dt_s**2
    return np.asarray(motion.angle_deg + steady + ripple, np.float64)


def _after(motion: _Motion, dt_s: float) -> _Motion:
    """Motion `dt_s` after the start of a segment; the ripple's part of the rate ends with the segment."""
    angle = single(_angle(motion, np.array([dt_s])))
    rate = motion.rate_deg_per_s + motion.acceleration_deg_per_s2 * dt_s
    return motion._replace(angle_deg=angle, rate_deg_per_s=rate)


class _Sine(NamedTuple):
    angle_deg: float
    phase_rad: float
    frequency_hz: float
    amplitude_deg_per_s: float
    amplitude_at_start_deg_per_s: float


class SimulatedVibrationTable(SimulatedDevice):
    """Angular-vibration table: ``FREQ:SETP``, ``AMPL:SETP``, ``FREQ:ACT?``, ``AMPL:ACT?`` and ``RATE:TRAC?``.

    rate = A(t) sin(phase + 2 pi f t), A(t) = A + (A0 - A) exp(-t/swell); the phase is continuous. The trace has a
    sample every 0.5 ms, and holds the last 8192.
    """

    def __init__(self, clock: StationClock) -> None:
        self.frequency_hz = 1.0
        self.course = self._line = Timeline(clock, _Sine(0.0, 0.0, 1.0, 0.0, 0.0), _sine_rate)
        self._traced_ns = clock.now_ns()

        def set_amplitude(value: float) -> None:
            self._set(amplitude_deg_per_s=within(value, 0.0, _MAX_AMPLITUDE_DEG_PER_S))

        settings = {
            "FREQuency:SETPoint": lambda value: self._set(frequency_hz=within(value, 1e-3, _MAX_FREQUENCY_HZ)),
            "AMPLitude:SETPoint": set_amplitude,
        }
        queries = {
            "FREQuency:ACTual?": lambda: f"{self.frequency_hz:.6f}",
            "AMPLitude:ACTual?": lambda: self.now(self.amplitude_deg_per_s, 6),
            "RATE:ACTual?": lambda: self.now(self.rate_deg_per_s, 6),
            "RATE:TRACe?": self._trace,
        }
        super().__init__("GYROFLEET,SIMULATED VIBRATION TABLE,0,1", clock, settings, queries)

    def rate_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Rate at these times of the past, deg/s."""
        return self._line.at(t_ns)

    def amplitude_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Amplitude of the rate at these times of the past, deg/s."""
        return self._line.at(t_ns, _amplitude)

    def angle_deg(self, t_ns: IntArray | int) -> FloatArray:
        """Angle at these times of the past, deg."""
        return self._line.at(t_ns, _sine_angle)

    def _set(self, **changes: float) -> None:
        self.frequency_hz = changes.get("frequency_hz", self.frequency_hz)

        def plan(now_ns: int, present: _Sine, dt_s: float) -> list[Segment[_Sine]]:
            now = np.array([dt_s])
            turned = present._replace(
                angle_deg=single(_sine_angle(present, now)),
                phase_rad=(present.phase_rad + 2.0 * np.pi * present.frequency_hz * dt_s) % (2.0 * np.pi),
                amplitude_at_start_deg_per_s=single(_amplitude(present, now)),
            )
            return [Segment(now_ns, turned._replace(**changes))]

        self._line.change(plan)

    def _trace(self) -> str:
        """Rates since the last query: t0_ns,dt_ns,rate,rate,..."""
        dt_ns = _TRACE_DT_NS
        end = self.clock.now_ns() // dt_ns
        begin = max(self._traced_ns // dt_ns + 1, end - _MOST_IN_TRACE + 1)
        self._traced_ns = end * dt_ns
        times = np.arange(begin, end + 1, dtype=np.int64) * dt_ns
        return ",".join([str(begin * dt_ns), str(dt_ns), *(f"{rate:.6f}" for rate in self.rate_deg_per_s(times))])


def _amplitude(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    behind = sine.amplitude_at_start_deg_per_s - sine.amplitude_deg_per_s
    return np.asarray(sine.amplitude_deg_per_s + behind * np.exp(-dt_s / _SWELL_S), np.float64)


def _sine_rate(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    phase = sine.phase_rad + 2.0 * np.pi * sine.frequency_hz * dt_s
    return np.asarray(_amplitude(sine, dt_s) * np.sin(phase), np.float64)


def _sine_angle(sine: _Sine, dt_s: FloatArray) -> FloatArray:
    """Integrals of sin(p + w t) and exp(-t/s) sin(p + w t)."""
    omega, decay = 2.0 * np.pi * sine.frequency_hz, 1.0 / _SWELL_S
    phase = sine.phase_rad + omega * dt_s
    steady = (np.cos(sine.phase_rad) - np.cos(phase)) / omega
    swell = -(np.exp(-decay * dt_s) * (decay * np.sin(phase) + omega * np.cos(phase))) / (decay**2 + omega**2)
    swell += (decay * np.sin(sine.phase_rad) + omega * np.cos(sine.phase_rad)) / (decay**2 + omega**2)
    behind = sine.amplitude_at_start_deg_per_s - sine.amplitude_deg_per_s
    return np.asarray(sine.angle_deg + sine.amplitude_deg_per_s * steady + behind * swell, np.float64)
