"""Candidate tests that may decide between rival effects, as procedures that a station can run."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.next_test.candidate import CandidateTest, mounting
from analytics.loop.next_test.station_bounds import THERMAL, StationBounds
from analytics.loop.next_test.thermal_tests import thermal_tests
from analytics.loop.next_test.turning_tests import headings, rate_tests, rates_after_power_on, rates_at_temperatures

TURNING = ("input_rate", "table_rate", "rate_o", "rate_s", "table_acceleration")
STANDING = ("gravity_i", "gravity_o", "gravity_s", "position")
SUPPLY = ("supply_voltage", "supply_current")
POWER_ON = "time_since_power_on"
_MOST_WORDS = 12
_REMOUNT_S, _REMOUNT_OFF_S = 600.0, 60.0
_INPUT_AXIS = ("IRA_up", "IRA_down")
_OTHER_AXES = ("OA_up", "OA_down", "SA_up", "SA_down")


def candidate_tests(
    channels: Iterable[str],
    bounds: StationBounds,
    runs: Sequence[RunBlocks],
    positions: Mapping[str, float] | None = None,
) -> list[CandidateTest]:
    """Tests that move what rival effects depend on, rest, and the repetition of each kind of run.

    Parameters
    ----------
    channels: Needed by the rivals.
    runs: Runs of the unit.
    positions: Number of each word in the channel ``position``.
    """
    needed = set(channels)
    turns, warms = bool(needed.intersection(TURNING)), bool(needed.intersection((*THERMAL, POWER_ON)))
    has_others = all({"gravity_o", "gravity_s"} <= set(run.channels) for run in runs)
    found = rests(bounds) if needed else []
    if warms:
        found += thermal_tests(bounds)
    if turns:
        found += rate_tests(bounds, has_other_axes=all({"rate_o", "rate_s"} <= set(run.channels) for run in runs))
    if turns and needed.intersection(THERMAL):
        found += rates_at_temperatures(bounds)
    if turns and POWER_ON in needed:
        found += rates_after_power_on(bounds)
    if "table_angle" in needed:
        found += headings(bounds, has_other_axes=has_others)
    if needed.intersection(STANDING):
        # a bias of each position repeats or not in the same positions only
        words = _mounted_words(runs, positions or {}) if "position" in needed else []
        found += list(_remountings(words, has_others=has_others)) or _tumbles(has_others=has_others)
    if needed.intersection(SUPPLY) and bounds.least_v is not None and bounds.most_v is not None:
        found += _supply(bounds.least_v, bounds.most_v)
    if POWER_ON in needed:
        found += _power_ons(bounds)
    return [*found, *repetitions(runs)]


def repetitions(runs: Sequence[RunBlocks]) -> Iterator[CandidateTest]:
    """Each run once more."""
    for run in runs:
        what = Bilingual(f"repeat run {run.run}", f"重复试验{run.run}")
        yield CandidateTest(name=f"repeat_{_word(run.run)}", what=what, like=run.run)


def rests(bounds: StationBounds, hours: Sequence[float] = (1.0, 2.0, 4.0)) -> list[CandidateTest]:
    """At rest, with everything held."""
    at = {} if bounds.least_deg_c is None else {"temperature_deg_c": bounds.middle_deg_c, "wait_settled": []}
    where = "" if bounds.least_deg_c is None else f", at {bounds.middle_deg_c:g} degC"
    where_zh = "" if bounds.least_deg_c is None else f"，{bounds.middle_deg_c:g} degC"
    return [
        CandidateTest(
            name=f"rest_{each:g}_h",
            what=Bilingual(f"{each:g} h at rest from power-on{where}", f"通电后静止{each:g} h{where_zh}"),
            steps=({"name": "rest", "record_s": each * 3600.0} | at,),
        )
        for each in hours
    ]


def _tumbles(*, has_others: bool) -> Iterator[CandidateTest]:
    """Positions whose effect the unit's runs record: those of the other axes need their components of gravity."""
    positions = (*_INPUT_AXIS, *_OTHER_AXES) if has_others else (*_INPUT_AXIS, "IRA_horizontal")
    count, number = len(positions), "六" if has_others else "三"
    for minutes in (5.0, 15.0):
        steps = [
            each
            for position in positions
            for each in (mounting(position), {"name": "static", "position": position, "record_s": minutes * 60.0})
        ]
        yield CandidateTest(
            name=f"tumble_{minutes:g}_min",
            what=Bilingual(
                f"{count} positions, {minutes:g} min each, twice", f"{number}位置翻滚，每位置{minutes:g} min，两遍"
            ),
            steps=({"times": 2, "step": steps},),
        )


def _mounted_words(runs: Sequence[RunBlocks], positions: Mapping[str, float]) -> list[str]:
    """Words of the positions that the unit has been in."""
    numbers = {number for run in runs if "position" in run.channels for number in run.mean("position").tolist()}
    return [word for word, number in positions.items() if number in numbers]


def _remountings(words: Sequence[str], *, has_others: bool) -> Iterator[CandidateTest]:
    """Each position of the unit's runs mounted again, with a power-on each, without and with the positions of axes."""
    axes = (*_INPUT_AXIS, *_OTHER_AXES) if has_others else _INPUT_AXIS
    for added in ((), tuple(each for each in axes if each not in words)) if 1 < len(words) <= _MOST_WORDS else ():
        for times in (2, 3):
            steps = [
                {
                    "name": "static",
                    "position": word,
                    "prompt": {"en": f"Mount the units again: {word}.", "zh": f"重新安装陀螺仪：{word}。"},
                    "power": "cycle",
                    "off_s": _REMOUNT_OFF_S,
                    "record_s": _REMOUNT_S,
                }
                for word in (*words, *added)
            ]
            more = ("", "") if not added else (f" and {len(added)} along the axes", f"及沿各轴的{len(added)}个位置")
            minutes = _REMOUNT_S / 60.0
            yield CandidateTest(
                name=f"remounting_{len(steps)}_positions_{times}_times",
                what=Bilingual(
                    f"the {len(words)} positions of the runs{more[0]}, each mounted {times} times with a power-on, "
                    f"{minutes:g} min each",
                    f"已做试验的{len(words)}个位置{more[1]}，每位置重新安装并通电{times}次，每次{minutes:g} min",
                ),
                steps=({"times": times, "step": steps},),
            )


def _supply(least_v: float, most_v: float) -> Iterator[CandidateTest]:
    levels = np.round(np.linspace(least_v, most_v, 5), 2)
    volts = tuple(map(float, (*levels, *levels[-2::-1])))
    for minutes in (5.0, 15.0):
        yield CandidateTest(
            name=f"supply_steps_{minutes:g}_min",
            what=Bilingual(
                f"supply of {levels[0]:g} to {levels[-1]:g} V in {levels.size} steps up and down, {minutes:g} min each",
                f"供电电压{levels[0]:g}至{levels[-1]:g} V分{levels.size}档升降，每档{minutes:g} min",
            ),
            steps=tuple(_supplied(each, minutes * 60.0) for each in volts),
            volts=volts,
        )


def _supplied(volts: float, record_s: float) -> dict[str, Any]:
    return {
        "name": f"supply {volts:g} V",
        "prompt": {"en": f"Set the supply to {volts:g} V.", "zh": f"将供电电压设为{volts:g} V。"},
        "record_s": record_s,
    }


def _power_ons(bounds: StationBounds) -> Iterator[CandidateTest]:
    """Power-ons after a soak: at one temperature, and at the least and the most."""
    low, high = bounds.least_deg_c, bounds.most_deg_c
    sets: list[list[float | None]] = [[None]] if low is None or high is None else [[bounds.middle_deg_c], [low, high]]
    for temperatures in sets:
        at = len(temperatures)
        for hours in (1.0, 2.0, 4.0, 8.0):
            yield CandidateTest(
                name=f"power_cycles_{at}_temperatures_{hours:g}_h",
                what=Bilingual(
                    f"power-on after one hour without power, {hours:g} h on, at {_counted(at, 'temperature')}",
                    f"断电1 h后通电{hours:g} h，共{at}个温度",
                ),
                steps=tuple(
                    {"name": "power on", "power": "cycle", "off_s": 3600.0, "record_s": hours * 3600.0}
                    | ({} if each is None else {"temperature_deg_c": each, "wait_settled": []})
                    for each in temperatures
                ),
            )


def _counted(count: int, noun: str) -> str:
    return f"each of {count} {noun}s" if count > 1 else f"one {noun}"


def _word(text: str) -> str:
    return "".join(each if each.isalnum() else "_" for each in text.lower())
