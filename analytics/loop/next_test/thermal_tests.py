"""Tests that change the temperature: triangles, two slopes, levels."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.next_test.candidate import CandidateTest, loop
from analytics.loop.next_test.station_bounds import StationBounds
from stream.batch import FloatArray

_HOURS = (1.0, 2.0, 4.0, 6.0)
_STAIR_DEG_C = 1.0  # a slope is a stair, which the thermal mass of a unit smooths
_SHORTEST_PERIOD_S, _LEAST_CYCLES = 900.0, 1.5
_DWELL_S, _SHORTEST_LEVEL_S = 1800.0, 1200.0


def thermal_tests(bounds: StationBounds) -> Iterator[CandidateTest]:
    """Tests between the least and the most temperature of the station; none without them."""
    least, most = bounds.least_deg_c, bounds.most_deg_c
    if least is None or most is None:
        return
    half, fastest = (most - least) / 2, bounds.slope_deg_c_per_min
    for hours in _HOURS:
        for slope in (fastest, fastest / 2, fastest / 4):
            for swing in sorted({min(half, 10.0), min(half, 20.0), half}):
                period_s = 4 * swing / slope * 60.0
                if _SHORTEST_PERIOD_S <= period_s <= hours * 3600.0 / _LEAST_CYCLES:
                    yield _triangle(bounds.middle_deg_c, swing, slope, hours, int(hours * 3600.0 // period_s))
        for swing in sorted({min(half, 20.0), half}):
            cycle_s = 4 * swing * (1 / fastest + 4 / fastest) * 60.0 + 4 * _DWELL_S
            if cycle_s <= hours * 3600.0:
                yield _two_slopes(bounds.middle_deg_c, swing, fastest, hours, int(hours * 3600.0 // cycle_s))
        for count in (2, 4):
            dwell_s = hours * 3600.0 / (2 * count - 1)
            if dwell_s >= _SHORTEST_LEVEL_S:
                yield _levels(np.round(np.linspace(least, most, count), 1), dwell_s, hours)


def _triangle(middle: float, swing: float, slope: float, hours: float, cycles: int) -> CandidateTest:
    up, down = _sides(middle, swing)
    return CandidateTest(
        name=_name(f"triangle_{swing:g}_deg_c_{slope:g}_per_min", hours),
        what=Bilingual(
            f"temperature triangle of +-{swing:g} degC about {middle:g} degC at {slope:g} degC/min, {cycles} cycles",
            f"以{middle:g} degC为中心±{swing:g} degC三角波变温，{slope:g} degC/min，{cycles}个周期",
        ),
        steps=(_start(up[0]), {"times": cycles, "step": [_stair([*up, *down], slope)]}),
    )


def _two_slopes(middle: float, swing: float, fastest: float, hours: float, cycles: int) -> CandidateTest:
    """Cycles at the fastest slope and at a quarter of it, with dwells at both ends: what lags, and what follows."""
    up, down = _sides(middle, swing)
    dwell = {"name": "dwell", "record_s": _DWELL_S}
    steps = [
        each for slope in (fastest, fastest / 4) for side in (up, down) for each in (_stair([*side], slope), dwell)
    ]
    minutes = _DWELL_S / 60
    return CandidateTest(
        name=_name(f"two_slopes_{swing:g}_deg_c", hours),
        what=Bilingual(
            f"+-{swing:g} degC about {middle:g} degC at {fastest:g} and at {fastest / 4:g} degC/min, with dwells of "
            f"{minutes:g} min at both ends, {cycles} times",
            f"以{middle:g} degC为中心±{swing:g} degC，先后以{fastest:g}与{fastest / 4:g} degC/min变温，两端各保温"
            f"{minutes:g} min，{cycles}遍",
        ),
        steps=(_start(up[0]), {"times": cycles, "step": steps}),
    )


def _levels(levels: FloatArray, dwell_s: float, hours: float) -> CandidateTest:
    least, most, minutes = levels[0], levels[-1], dwell_s / 60
    return CandidateTest(
        name=_name(f"{levels.size}_levels", hours),
        what=Bilingual(
            f"{levels.size} temperatures from {least:g} to {most:g} degC, up and down, {minutes:.0f} min each",
            f"{least:g}至{most:g} degC之间{levels.size}个温度点升降各一次，每点{minutes:.0f} min",
        ),
        steps=(loop("temperature_deg_c", [*levels, *levels[-2::-1]], dwell_s),),
    )


def _sides(middle: float, swing: float) -> tuple[FloatArray, FloatArray]:
    up = np.arange(middle - swing, middle + swing, _STAIR_DEG_C)
    return up, 2 * middle - up


def _stair(values: list[float], slope: float) -> dict[str, Any]:
    return loop("temperature_deg_c", values, _STAIR_DEG_C / slope * 60.0) | {"wait_settled": []}


def _start(deg_c: float) -> dict[str, Any]:
    return {"name": "start", "temperature_deg_c": float(deg_c), "record_s": 600.0, "wait_settled": []}


def _name(what: str, hours: float) -> str:
    return f"temperature_{what}_{hours:g}_h".replace(".", "p")
