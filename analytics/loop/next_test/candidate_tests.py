"""Candidate tests that may decide between rival effects, as procedures that a station can run."""

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from ingest.procedures.file import ProcedureFile
from ingest.procedures.plan import PlannedStep, Planner, Used
from stream.errors import BadInput

THERMAL = ("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint")
TURNING = ("input_rate", "table_rate", "rate_o", "rate_s", "table_angle", "table_acceleration")
STANDING = ("gravity_i", "gravity_o", "gravity_s", "position")
SUPPLY = ("supply_voltage", "supply_current")
_STAIR_DEG_C = 1.0
_LEAST_RATE_DEG_PER_S = 1e-3  # less is the noise of a table at rest
_HOURS = (1.0, 2.0, 4.0, 6.0)
_POSITIONS = ("IRA_up", "IRA_down", "OA_up", "OA_down", "SA_up", "SA_down")


class StationBounds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What chamber, rate table and supply may be set to in a test.

    Parameters
    ----------
    slope_deg_c_per_min: Fastest ramp of the chamber.
    acceleration_deg_per_s2: Of the rate table.
    least_deg_c, most_deg_c, rate_deg_per_s: None if the chamber, or the table, is not to be used.
    least_v, most_v: None if the supply is not to be changed.
    """

    slope_deg_c_per_min: float = 2.0
    acceleration_deg_per_s2: float = 50.0
    least_deg_c: float | None = None
    most_deg_c: float | None = None
    rate_deg_per_s: float | None = None
    least_v: float | None = None
    most_v: float | None = None

    @classmethod
    def of_runs(cls, runs: Sequence[RunBlocks], **given: Any) -> "StationBounds":
        """What the unit has been through in its runs, as far as it is not given."""
        known: dict[str, float] = {}
        if (temperatures := _range(runs, THERMAL[::-1])) is not None and np.ptp(temperatures) > _STAIR_DEG_C:
            known["least_deg_c"], known["most_deg_c"] = (float(np.round(each)) for each in temperatures)
        rates = _range(runs, ("input_rate", "table_rate"))
        if rates is not None and (most := float(f"{np.abs(rates).max():.2g}")) > _LEAST_RATE_DEG_PER_S:
            known["rate_deg_per_s"] = most
        volts = _range(runs, ("supply_voltage",))
        if volts is not None and np.ptp(volts) > 0.01 * abs(float(np.mean(volts))):
            known["least_v"], known["most_v"] = (float(np.round(each, 1)) for each in volts)
        return cls(**{**known, **{name: value for name, value in given.items() if value is not None}})


class CandidateTest(msgspec.Struct, frozen=True, kw_only=True):
    """A test: its name, what is done, and its steps as in the file of a procedure.

    Parameters
    ----------
    repeats: Runs of it, each with a power-on of its own.
    like: The run that it repeats; it then has no steps of its own.
    """

    name: str
    what: Bilingual
    steps: tuple[dict[str, Any], ...] = ()
    repeats: int = 1
    like: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """The procedure as in its file."""
        return {
            "name": self.name,
            "names": {"en": str(self.what), "zh": self.what.zh},
            "source": ["gyrofleet diagnose --next-test"],
            "step": list(self.steps),
        }

    def planned(self) -> tuple[PlannedStep, ...]:
        """Its steps as `gyrofleet run` executes them; BadInput if they are none that it can."""
        try:
            file = msgspec.convert(self.document, ProcedureFile)
        except msgspec.ValidationError as error:
            raise BadInput(f"test {self.name}: {error}") from error
        return Planner(self.name).plan(Used(file.items, self.name, {}), {})


def candidate_tests(channels: Iterable[str], bounds: StationBounds, runs: Sequence[RunBlocks]) -> list[CandidateTest]:
    """Tests that move what rival effects depend on, and the repetition of each kind of run.

    Parameters
    ----------
    channels: Needed by the rivals.
    runs: Runs of the unit.
    """
    needed = set(channels)
    found: list[CandidateTest] = []
    if needed.intersection((*THERMAL, "time_since_power_on")) and None not in (bounds.least_deg_c, bounds.most_deg_c):
        found += _thermal(bounds)
    if needed.intersection(TURNING) and bounds.rate_deg_per_s:
        found += _turning(bounds.rate_deg_per_s)
    if needed.intersection(STANDING):
        found += _tumbles()
    if needed.intersection(SUPPLY) and None not in (bounds.least_v, bounds.most_v):
        found += _supply(bounds)
    if "time_since_power_on" in needed:
        found += _power_ons(bounds)
    return found + [
        CandidateTest(
            name=f"repeat_{_word(run.run)}", what=Bilingual(f"repeat run {run.run}", f"重复试验{run.run}"), like=run.run
        )
        for run in runs
    ]


def _thermal(bounds: StationBounds) -> list[CandidateTest]:
    """Triangles and stairs of temperature; a slope is a stair of 1 degC, which the thermal mass of a unit smooths."""
    least, most = bounds.least_deg_c, bounds.most_deg_c
    assert least is not None
    assert most is not None
    middle, half = (least + most) / 2, (most - least) / 2
    found = []
    for hours in _HOURS:
        for slope in sorted({bounds.slope_deg_c_per_min / part for part in (1, 2, 4)}, reverse=True):
            for swing in sorted({min(half, each) for each in (10.0, 20.0, half)}):
                period_s = 4 * swing / slope * 60.0
                if not 900.0 <= period_s <= hours * 3600.0 / 1.5:
                    continue
                cycles = max(1, int(hours * 3600.0 // period_s))
                found.append(
                    CandidateTest(
                        name=f"temperature_triangle_{swing:g}_deg_c_{slope:g}_per_min_{hours:g}_h".replace(".", "p"),
                        what=Bilingual(
                            f"temperature triangle of +-{swing:g} degC about {middle:g} degC at {slope:g} degC/min, "
                            f"{cycles} cycles",
                            f"以{middle:g} degC为中心±{swing:g} degC三角波变温，{slope:g} degC/min，{cycles}个周期",
                        ),
                        steps=_triangle(middle, swing, slope, cycles),
                    )
                )
        for swing in sorted({min(half, 20.0), half}):
            found += _two_slopes(middle, swing, bounds.slope_deg_c_per_min, hours)
        for count in (2, 4):
            levels = np.round(np.linspace(least, most, count), 1)
            dwell_s = hours * 3600.0 / (2 * count - 1)
            if dwell_s < 1200.0:
                continue
            found.append(
                CandidateTest(
                    name=f"temperature_{count}_levels_{hours:g}_h".replace(".", "p"),
                    what=Bilingual(
                        f"{count} temperatures from {least:g} to {most:g} degC, up and down, "
                        f"{dwell_s / 60:.0f} min each",
                        f"{least:g}至{most:g} degC之间{count}个温度点升降各一次，每点{dwell_s / 60:.0f} min",
                    ),
                    steps=(_loop("temperature_deg_c", [*levels, *levels[-2::-1]], dwell_s),),
                )
            )
    return found


def _two_slopes(middle: float, swing: float, fastest: float, hours: float) -> list[CandidateTest]:
    """Cycles at the fastest slope and at a quarter of it, with dwells at both ends: what lags, and what follows."""
    slow = fastest / 4
    dwell_s = 1800.0
    cycle_s = 4 * swing / fastest * 60.0 + 4 * swing / slow * 60.0 + 4 * dwell_s
    if cycle_s > hours * 3600.0:
        return []
    cycles = int(hours * 3600.0 // cycle_s)
    dwell = {"name": "dwell", "record_s": dwell_s}
    steps: list[dict[str, Any]] = []
    for slope in (fastest, slow):
        up = np.arange(middle - swing, middle + swing, _STAIR_DEG_C)
        for values in (up, 2 * middle - up):
            steps += [
                _loop("temperature_deg_c", list(values), _STAIR_DEG_C / slope * 60.0) | {"wait_settled": []},
                dwell,
            ]
    start = {"name": "start", "temperature_deg_c": middle - swing, "record_s": 600.0, "wait_settled": []}
    return [
        CandidateTest(
            name=f"temperature_two_slopes_{swing:g}_deg_c_{hours:g}_h".replace(".", "p"),
            what=Bilingual(
                f"+-{swing:g} degC about {middle:g} degC at {fastest:g} and at {slow:g} degC/min, with dwells of "
                f"{dwell_s / 60:g} min at both ends, {cycles} times",
                f"以{middle:g} degC为中心±{swing:g} degC，先后以{fastest:g}与{slow:g} degC/min变温，两端各保温"
                f"{dwell_s / 60:g} min，{cycles}遍",
            ),
            steps=(start, {"times": cycles, "step": steps}),
        )
    ]


def _triangle(middle: float, swing: float, slope: float, cycles: int) -> tuple[dict[str, Any], ...]:
    up = np.arange(middle - swing, middle + swing, _STAIR_DEG_C)
    values = [*up, *(2 * middle - up)]
    stair = _loop("temperature_deg_c", values, _STAIR_DEG_C / slope * 60.0) | {"wait_settled": []}
    start = {"name": "start", "temperature_deg_c": float(values[0]), "record_s": 600.0, "wait_settled": []}
    return (start, {"times": cycles, "step": [stair]})


def _turning(most: float) -> list[CandidateTest]:
    found = []
    for hours in _HOURS[:3]:
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
                        "step": [_loop("rate_deg_per_s", both, stay_s)],
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
                steps=({"times": round(hours * 30), "step": [_loop("rate_deg_per_s", [most, -most], 60.0)]}, _stop()),
            )
        )
    return found


def _tumbles() -> list[CandidateTest]:
    return [
        CandidateTest(
            name=f"tumble_{minutes:g}_min",
            what=Bilingual(f"six positions, {minutes:g} min each, twice", f"六位置翻滚，每位置{minutes:g} min，两遍"),
            steps=({"times": 2, "step": [_mounted(position, minutes * 60.0) for position in _POSITIONS]},),
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


def _supply(bounds: StationBounds) -> list[CandidateTest]:
    assert bounds.least_v is not None
    assert bounds.most_v is not None
    levels = np.round(np.linspace(bounds.least_v, bounds.most_v, 5), 2)
    return [
        CandidateTest(
            name=f"supply_steps_{minutes:g}_min",
            what=Bilingual(
                f"supply of {levels[0]:g} to {levels[-1]:g} V in {levels.size} steps up and down, {minutes:g} min each",
                f"供电电压{levels[0]:g}至{levels[-1]:g} V分{levels.size}档升降，每档{minutes:g} min",
            ),
            steps=tuple(_supplied(float(volts), minutes * 60.0) for volts in (*levels, *levels[-2::-1])),
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


def _loop(setting: str, values: Sequence[float], record_s: float) -> dict[str, Any]:
    name = setting.partition("_")[0]
    return {
        "for": name,
        "values": [float(np.round(each, 3)) for each in values],
        setting: f"${name}",
        "step": [{"name": name, "record_s": float(np.round(record_s, 1))}],
    }


def _stop() -> dict[str, Any]:
    return {"name": "stop", "rate_deg_per_s": 0.0, "record_s": 60.0}


def _range(runs: Sequence[RunBlocks], names: Sequence[str]) -> tuple[float, float] | None:
    """Range of the first of these channels that every run has."""
    for name in names:
        if all(name in run.channels for run in runs):
            values = np.concatenate([run.mean(name) for run in runs])
            if np.isfinite(values).any():
                return float(np.nanmin(values)), float(np.nanmax(values))
    return None


def _word(text: str) -> str:
    return "".join(each if each.isalnum() else "_" for each in text.lower())
