"""A simulated single-axis rate table that speaks SCPI: limited acceleration, and a small ripple while it turns."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ingest.simulator.scpi.device import SimulatedDevice, single, within
from ingest.simulator.timeline import Stretch, Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray


class _Motion(NamedTuple):
    angle_deg: float
    rate_deg_per_s: float
    acceleration_deg_per_s2: float
    ripple_deg_per_s: float
    ripple_hz: float


class SimulatedRateTable(SimulatedDevice):
    """Rate table: ``RATE:SETP``, ``ANGL:SETP``, ``RATE:ACT?``, ``ANGL:ACT?``.

    Parameters
    ----------
    clock: The station's clock.
    max_rate_deg_per_s, acceleration_deg_per_s2: What it can do.
    positioning_rate_deg_per_s: How fast it turns to a position.
    ripple_deg_per_s, ripple_hz: Amplitude and frequency of a sine on the rate while it turns; at rest there is none.

    Notes
    -----
    Stretches of constant acceleration; the angle is the exact integral of the rate, ripple included. The angle is not
    reduced to a turn.

    Examples
    --------
    >>> table = SimulatedRateTable(StationClock(start_ns=0), ripple_deg_per_s=0.0)
    >>> table.handle("RATE:SETP -20")
    >>> float(table.rate_deg_per_s(3600 * 10**9))
    -20.0
    """

    def __init__(
        self,
        clock: StationClock,
        *,
        max_rate_deg_per_s: float = 400.0,
        acceleration_deg_per_s2: float = 100.0,
        positioning_rate_deg_per_s: float = 30.0,
        ripple_deg_per_s: float = 2e-4,
        ripple_hz: float = 7.0,
    ) -> None:
        super().__init__(
            "GYROFLEET,SIMULATED RATE TABLE,0,1",
            clock,
            {"RATE:SETPoint": self._set_rate, "ANGLe:SETPoint": self._set_angle},
            {
                "RATE:ACTual?": lambda: f"{single(self.rate_deg_per_s(clock.now_ns())):.6f}",
                "ANGLe:ACTual?": lambda: f"{single(self.angle_deg(clock.now_ns())):.6f}",
            },
        )
        self._max_rate = max_rate_deg_per_s
        self._acceleration = acceleration_deg_per_s2
        self._positioning_rate = positioning_rate_deg_per_s
        self._ripple = ripple_deg_per_s, ripple_hz
        at_rest = _Motion(0.0, 0.0, 0.0, 0.0, ripple_hz)
        self.course = self._rate = Timeline(clock, at_rest, _rate)

    def rate_deg_per_s(self, t_ns: IntArray | int) -> FloatArray:
        """Rate at these times of the past, deg/s."""
        return self._rate.at(t_ns)

    def angle_deg(self, t_ns: IntArray | int) -> FloatArray:
        """Angle at these times of the past, deg, turns counted on."""
        return self._rate.at(t_ns, _angle)

    def _set_rate(self, value: float) -> None:
        target = within(value, -self._max_rate, self._max_rate)
        self._move(lambda motion: [_to_rate(motion.rate_deg_per_s, target, self._acceleration)], target)

    def _set_angle(self, value: float) -> None:
        a, fastest = self._acceleration, self._positioning_rate

        def legs(motion: _Motion) -> list[tuple[float, float]]:
            stop = _to_rate(motion.rate_deg_per_s, 0.0, a)
            way = value - (motion.angle_deg + motion.rate_deg_per_s * stop[0] / 2.0)
            peak = min(fastest, math.sqrt(a * abs(way)))
            up = math.copysign(a, way)
            level_s = max(0.0, abs(way) - peak**2 / a) / peak if peak else 0.0
            return [stop, (peak / a, up), (level_s, 0.0), (peak / a, -up)]

        self._move(legs, 0.0, value)

    def _move(
        self, legs: Callable[[_Motion], list[tuple[float, float]]], rate: float, angle: float | None = None
    ) -> None:
        def plan(now_ns: int, present: _Motion, dt_s: float) -> list[Stretch[_Motion]]:
            motion = _after(present, dt_s)
            t_ns, stretches = now_ns, []
            for duration_s, acceleration in legs(motion):
                if duration_s <= 0.0:
                    continue
                motion = motion._replace(acceleration_deg_per_s2=acceleration, ripple_deg_per_s=0.0)
                stretches.append(Stretch(t_ns, motion))
                motion = _after(motion, duration_s)
                t_ns += round(duration_s * 1e9)
            end = motion.angle_deg if angle is None else angle
            ripple = self._ripple[0] if rate else 0.0
            stretches.append(Stretch(t_ns, _Motion(end, rate, 0.0, ripple, self._ripple[1])))
            return stretches

        self._rate.change(plan)


def _to_rate(rate: float, target: float, acceleration: float) -> tuple[float, float]:
    """Seconds, and acceleration, from one rate to another."""
    return abs(target - rate) / acceleration, math.copysign(acceleration, target - rate)


def _rate(motion: _Motion, dt_s: FloatArray) -> FloatArray:
    ripple = motion.ripple_deg_per_s * np.sin(2.0 * np.pi * motion.ripple_hz * dt_s)
    return np.asarray(motion.rate_deg_per_s + motion.acceleration_deg_per_s2 * dt_s + ripple, np.float64)


def _angle(motion: _Motion, dt_s: FloatArray) -> FloatArray:
    omega = 2.0 * np.pi * motion.ripple_hz
    ripple = motion.ripple_deg_per_s * (1.0 - np.cos(omega * dt_s)) / omega
    steady = motion.rate_deg_per_s * dt_s + 0.5 * motion.acceleration_deg_per_s2 * dt_s**2
    return np.asarray(motion.angle_deg + steady + ripple, np.float64)


def _after(motion: _Motion, dt_s: float) -> _Motion:
    """Where a stretch has come to; the ripple's part of the rate ends with it."""
    angle = single(_angle(motion, np.array([dt_s])))
    return motion._replace(
        angle_deg=angle, rate_deg_per_s=motion.rate_deg_per_s + motion.acceleration_deg_per_s2 * dt_s
    )
