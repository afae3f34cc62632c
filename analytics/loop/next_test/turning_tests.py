"""Tests that turn the table: ladders of rates, reversals, rates in other mountings and temperatures, headings."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.next_test.candidate import CandidateTest, loop, mounting
from analytics.loop.next_test.station_bounds import StationBounds
from stream.batch import FloatArray

_HOURS = (1.0, 2.0, 4.0, 8.0)
_COARSE = (0.02, 0.1, 0.3, 0.6, 1.0)
_FINE = (0.005, 0.02, 0.05, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
_HALF, _HALVES = (0.0, 0.5), (0.0, 0.5, 1.0)
"""Parts of the largest rate: the fine ones lie on both sides of every dead zone and saturation of the library; at half
of it a square and a magnitude that agree at the largest rate differ most."""
_STAY_S, _REVERSAL_S, _STILL_S = 120.0, 60.0, 60.0
_SOAK_S = 3600.0
_MOST_ANGLES = 8
_HORIZONTAL = ("OA_up", "SA_up")
_UP = "IRA_up"


def rate_tests(bounds: StationBounds, *, has_other_axes: bool) -> Iterator[CandidateTest]:
    """Tests at rates about the input axis, and where they are recorded about the other axes."""
    most = bounds.rate_deg_per_s
    if most is None:
        return
    for hours in _HOURS:
        for parts in (_COARSE, _FINE, _HALF, _HALVES):
            yield _ladder(most, parts, hours)
        yield CandidateTest(
            name=f"rate_reversals_{hours:g}_h",
            what=Bilingual(
                f"reversals between +-{most:g} deg/s every {_REVERSAL_S:g} s, for {hours:g} h",
                f"±{most:g} deg/s每{_REVERSAL_S:g} s换向一次，共{hours:g} h",
            ),
            steps=(
                mounting(_UP),
                {
                    "times": round(hours * 1800.0 / _REVERSAL_S),
                    "position": _UP,
                    "step": [loop("rate_deg_per_s", [most, -most], _REVERSAL_S)],
                },
                still(_UP),
            ),
        )
    if has_other_axes:
        for times in (1, 2):
            yield _mounted_rates(most, times)


def _ladder(most: float, parts: Sequence[float], hours: float) -> CandidateTest:
    rates = _both_ways(most, parts)
    cycle_s, largest = _STAY_S * rates.size, float(rates.max())
    listed = ", ".join(f"{each:g}" for each in np.unique(np.abs(rates)))
    return CandidateTest(
        name=f"rate_ladder_{len(parts)}_rates_to_{largest:g}_{hours:g}_h".replace(".", "p"),
        what=Bilingual(
            f"rates of +-({listed}) deg/s in turn, {_STAY_S:g} s each, for {hours:g} h",
            f"±({listed.replace(', ', '、')}) deg/s各档角速率交替，每档{_STAY_S:g} s，共{hours:g} h",
        ),
        steps=(
            mounting(_UP),
            {
                "times": max(1, round(hours * 3600.0 / cycle_s)),
                "position": _UP,
                "step": [loop("rate_deg_per_s", rates, _STAY_S)],
            },
            still(_UP),
        ),
    )


def _mounted_rates(most: float, times: int) -> CandidateTest:
    positions = (_UP, *_HORIZONTAL)
    steps: list[dict[str, Any]] = []
    for position in positions:
        ladder = loop("rate_deg_per_s", _both_ways(most, _COARSE), _STAY_S) | {"position": position}
        steps += [mounting(position), ladder, still(position)]
    return CandidateTest(
        name=f"rates_about_{len(positions)}_axes_{times}_times",
        what=Bilingual(
            f"{len(_COARSE)} rates up to +-{most:g} deg/s about each of {len(positions)} axes, {times} times",
            f"绕{len(positions)}个轴各以至±{most:g} deg/s的{len(_COARSE)}档角速率旋转，{times}遍",
        ),
        steps=({"times": times, "step": steps},),
    )


def rates_at_temperatures(bounds: StationBounds) -> Iterator[CandidateTest]:
    """Rates at soaked temperatures, rising and falling."""
    most, low, high = bounds.rate_deg_per_s, bounds.least_deg_c, bounds.most_deg_c
    if most is None or low is None or high is None:
        return
    for count in (2, 3):
        levels = np.round(np.linspace(low, high, count), 1)
        every = [*levels, *levels[-2::-1]] if count > 2 else [*levels]
        steps: list[dict[str, Any]] = [mounting(_UP)]
        for level in every:
            soak = {"name": "soak", "temperature_deg_c": float(level), "record_s": _SOAK_S, "position": _UP}
            ladder = loop("rate_deg_per_s", _both_ways(most, _COARSE), _STAY_S) | {"position": _UP}
            steps += [soak | {"wait_settled": ["temperature"]}, ladder, still(_UP)]
        yield CandidateTest(
            name=f"rates_at_{len(every)}_temperatures",
            what=Bilingual(
                f"{len(_COARSE)} rates up to +-{most:g} deg/s at {count} temperatures from {low:g} to {high:g} degC, "
                "after a soak of 1 h each",
                f"在{low:g}至{high:g} degC的{count}个温度点各保温1 h后，"
                f"以至±{most:g} deg/s的{len(_COARSE)}档角速率旋转",
            ),
            steps=tuple(steps),
        )


def rates_after_power_on(bounds: StationBounds) -> Iterator[CandidateTest]:
    """Reversals from a power-on of the soaked unit on."""
    most = bounds.rate_deg_per_s
    if most is None:
        return
    for hours in (2.0, 4.0):
        yield CandidateTest(
            name=f"rates_after_power_on_{hours:g}_h",
            what=Bilingual(
                f"reversals between +-{most:g} deg/s for {hours:g} h from a power-on after one hour without power",
                f"断电1 h后通电，随即以±{most:g} deg/s换向旋转{hours:g} h",
            ),
            steps=(
                mounting(_UP),
                {"name": "power on", "power": "cycle", "off_s": 3600.0, "record_s": _STILL_S, "position": _UP},
                {
                    "times": round(hours * 1800.0 / _REVERSAL_S),
                    "position": _UP,
                    "step": [loop("rate_deg_per_s", [most, -most], _REVERSAL_S)],
                },
                still(_UP),
            ),
        )


def headings(bounds: StationBounds, *, has_other_axes: bool) -> Iterator[CandidateTest]:
    """At rest at table angles with the input axis horizontal, and again with it vertical."""
    least, most = bounds.least_angle_deg, bounds.most_angle_deg
    if least is None or most is None:
        return
    turn = min(most - least, 360.0)
    # 0 and 360 deg are one heading
    angles = np.round(least + turn / _MOST_ANGLES * np.arange(_MOST_ANGLES + (turn < 360.0)), 1)
    level = _HORIZONTAL[0] if has_other_axes else "IRA_horizontal"
    for minutes in (3.0, 6.0, 15.0):
        for positions in ((level,), (level, _UP)):
            steps: list[dict[str, Any]] = []
            for position in positions:
                both = [*angles, *angles[::-1]]
                steps += [mounting(position), loop("angle_deg", both, minutes * 60.0) | {"position": position}]
            yield CandidateTest(
                name=f"headings_{len(angles)}_angles_{len(positions)}_positions_{minutes:g}_min",
                what=Bilingual(
                    f"at rest at {len(angles)} table angles from {least:g} to {angles[-1]:g} deg, there and back, "
                    f"{minutes:g} min each, "
                    + ("input axis horizontal", "input axis horizontal and vertical")[len(positions) - 1],
                    f"在{least:g}至{angles[-1]:g} deg的{len(angles)}个台面角度往返静止测量，每角度{minutes:g} min，"
                    + ("输入轴水平", "输入轴水平与竖直各一次")[len(positions) - 1],
                ),
                steps=tuple(steps),
            )


def still(position: str) -> dict[str, Any]:
    """The table at rest, as an operator needs it."""
    return {"name": "stop", "rate_deg_per_s": 0.0, "record_s": _STILL_S, "position": position}


def _both_ways(most: float, parts: Sequence[float]) -> FloatArray:
    """Rates in both directions, large and small in turn: slow noise does not look like a function of the rate."""
    rising = np.round(most * np.sort(np.array(parts)), 4)
    order = [at for pair in zip(range(rising.size), range(rising.size - 1, -1, -1), strict=True) for at in pair]
    mixed = rising[list(dict.fromkeys(order))] * (-1.0) ** np.arange(rising.size)
    return np.concatenate([mixed, -mixed])
