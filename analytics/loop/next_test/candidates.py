"""Candidate tests that may decide between rival effects, as procedures that a station can run."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.next_test.candidate import CandidateTest, loop
from analytics.loop.next_test.station_bounds import THERMAL, StationBounds
from analytics.loop.next_test.thermal_tests import thermal_tests

TURNING = ("input_rate", "table_rate", "rate_o", "rate_s", "table_angle", "table_acceleration")
STANDING = ("gravity_i", "gravity_o", "gravity_s", "position")
SUPPLY = ("supply_voltage", "supply_current")
_HOURS = (1.0, 2.0, 4.0)
_INPUT_AXIS = ("IRA_up", "IRA_down")
_OTHER_AXES = ("OA_up", "OA_down", "SA_up", "SA_down")


def candidate_tests(channels: Iterable[str], bounds: StationBounds, runs: Sequence[RunBlocks]) -> list[CandidateTest]:
    """Tests that move what rival effects depend on, and the repetition of each kind of run.

    Parameters
    ----------
    channels: Needed by the rivals.
    runs: Runs of the unit.
    """
    needed = set(channels)
    found: list[CandidateTest] = []
    if needed.intersection((*THERMAL, "time_since_power_on")):
        found += thermal_tests(bounds)
    if needed.intersection(TURNING) and bounds.rate_deg_per_s:
        found += _turning(bounds.rate_deg_per_s)
    if needed.intersection(STANDING):
        found += _tumbles(runs)
    if needed.intersection(SUPPLY) and bounds.least_v is not None and bounds.most_v is not None:
        found += _supply(bounds.least_v, bounds.most_v)
    if "time_since_power_on" in needed:
        found += _power_ons(bounds)
    return found + [
        CandidateTest(
            name=f"repeat_{_word(run.run)}", what=Bilingual(f"repeat run {run.run}", f"重复试验{run.run}"), like=run.run
        )
        for run in runs
    ]


def _turning(most: float) -> list[CandidateTest]:
    found = []
    for hours in _HOURS:
        ladder = np.round(most * np.array([0.02, 0.1, 0.3, 0.6, 1.0]), 3)
        both = [*ladder, *-ladder, *ladder[::-1], *-ladder[::-1]]
        stay_s = 120.0
        found.append(
            CandidateTest(
                name=f"rate_ladder_{hours:g}_h",
                what=Bilingual(
                    f"rates from +-{ladder[0]:g} to +-{most:g} deg/s, {stay_s:g} s each, for {hours:g} h",
                    f"±{ladder[0]:g}至±{most:g} deg/s各档角速率，每档{stay_s:g} s，共{hours:g} h",
                ),
                steps=(
                    {
                        "times": max(1, round(hours * 3600 / stay_s / len(both))),
                        "step": [loop("rate_deg_per_s", both, stay_s)],
                    },
                    _stop(),
                ),
            )
        )
        found.append(
            CandidateTest(
                name=f"rate_reversals_{hours:g}_h",
                what=Bilingual(
                    f"reversals between +-{most:g} deg/s every 60 s, for {hours:g} h",
                    f"±{most:g} deg/s每60 s换向一次，共{hours:g} h",
                ),
                steps=({"times": round(hours * 30), "step": [loop("rate_deg_per_s", [most, -most], 60.0)]}, _stop()),
            )
        )
    return found


def _tumbles(runs: Sequence[RunBlocks]) -> list[CandidateTest]:
    """Positions whose effect the unit's runs record: those of the other axes need their components of gravity."""
    has_others = all({"gravity_o", "gravity_s"} <= set(run.channels) for run in runs)
    positions = (*_INPUT_AXIS, *_OTHER_AXES) if has_others else _INPUT_AXIS
    count, number = len(positions), "六" if has_others else "二"
    return [
        CandidateTest(
            name=f"tumble_{minutes:g}_min",
            what=Bilingual(
                f"{count} positions, {minutes:g} min each, twice", f"{number}位置翻滚，每位置{minutes:g} min，两遍"
            ),
            steps=({"times": 2, "step": [_mounted(position, minutes * 60.0) for position in positions]},),
        )
        for minutes in (5.0, 15.0)
    ]


def _mounted(position: str, record_s: float) -> dict[str, Any]:
    axis, _, towards = position.partition("_")
    way = {"up": "向上", "down": "向下"}[towards]
    return {
        "name": "static",
        "position": position,
        "prompt": {"en": f"Mount the units with {axis} {towards}.", "zh": f"将陀螺仪安装为{axis}{way}。"},
        "record_s": record_s,
    }


def _supply(least_v: float, most_v: float) -> list[CandidateTest]:
    levels = np.round(np.linspace(least_v, most_v, 5), 2)
    volts = tuple(map(float, (*levels, *levels[-2::-1])))
    return [
        CandidateTest(
            name=f"supply_steps_{minutes:g}_min",
            what=Bilingual(
                f"supply of {levels[0]:g} to {levels[-1]:g} V in {levels.size} steps up and down, {minutes:g} min each",
                f"供电电压{levels[0]:g}至{levels[-1]:g} V分{levels.size}档升降，每档{minutes:g} min",
            ),
            steps=tuple(_supplied(each, minutes * 60.0) for each in volts),
            volts=volts,
        )
        for minutes in (5.0, 15.0)
    ]


def _supplied(volts: float, record_s: float) -> dict[str, Any]:
    return {
        "name": f"supply {volts:g} V",
        "prompt": {"en": f"Set the supply to {volts:g} V.", "zh": f"将供电电压设为{volts:g} V。"},
        "record_s": record_s,
    }


def _power_ons(bounds: StationBounds) -> list[CandidateTest]:
    temperatures: list[float | None] = [None]
    if bounds.least_deg_c is not None and bounds.most_deg_c is not None:
        temperatures = [bounds.least_deg_c, bounds.most_deg_c]
    return [
        CandidateTest(
            name=f"power_cycles_{hours:g}_h",
            what=Bilingual(
                f"power-on after a soak of one hour, {hours:g} h on, at each of {len(temperatures)} temperatures",
                f"保温1 h后通电{hours:g} h，共{len(temperatures)}个温度",
            ),
            steps=tuple(
                {"name": "power on", "power": "cycle", "off_s": 3600.0, "record_s": hours * 3600.0}
                | ({} if each is None else {"temperature_deg_c": each, "wait_settled": []})
                for each in temperatures
            ),
        )
        for hours in (1.0, 2.0)
    ]


def _stop() -> dict[str, Any]:
    return {"name": "stop", "rate_deg_per_s": 0.0, "record_s": 60.0}


def _word(text: str) -> str:
    return "".join(each if each.isalnum() else "_" for each in text.lower())
