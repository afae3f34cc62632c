"""Whether a station explains what looks like ageing: units that were measured there all change with it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.events import STATION, StationChange
from analytics.loop.effects.registry import effect
from analytics.loop.model.declared_noise import run_constants
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import ConfoundedEffect, Diagnosis, FoundEffect, ModelVerdict
from stream.batch import BoolArray, FloatArray, IntArray

_DAY_NS = 86_400 * 10**9
_ADDS = 6.63  # chi-square of one degree of freedom, 1 %
_FEWEST_UNITS = 3  # on either side of a change, which a jump of one of them would imitate
_FEWEST_LEFT = 3  # degrees of freedom
_MOST_CHANGES = 60  # of one station that are tried


@dataclass(frozen=True)
class StationRival:
    """The constants of the runs of some units, and what their stations explain of them.

    The least-squares model has a constant for each unit, a level for each station, and the change of one station that
    explains most; ageing is not separated from these where it takes off less than 6.63 (1 %) of the chi-square that
    they leave.
    """

    units: tuple[str, ...]
    unit: IntArray  # of each run
    day: FloatArray  # of its middle
    value: FloatArray  # its constant beside the declared model
    levels: FloatArray  # columns of the stations

    def rival_of(self, found: FoundEffect, unit: str | None = None) -> ConfoundedEffect | None:
        """The station as an alternative to a drift over days, of one unit or of all; None where it is none."""
        if not is_of_days(found) or self.levels.shape[1] == 0:
            return None
        day, y = within_units(self.day[:, None], self.unit), within_units(self.value[:, None], self.unit)
        degrees = self.unit.size - len(self.units) - np.linalg.matrix_rank(self.levels) - 1
        if unit is None:
            left = [squares_left(each, y) for each in (day, self.levels, np.hstack([self.levels, day]))]
        else:  # the others may drift by their own
            at = self.units.index(unit)
            degrees -= len(self.units) - 1
            left = [squares_left(day * (self.unit == at)[:, None], y)]
            for drifting in (np.arange(len(self.units)) != at, np.ones(len(self.units), np.bool_)):
                levels, rest = (self._without_drifts(each, day[:, 0], drifting) for each in (self.levels, y))
                left.append(squares_left(levels, rest))
        if degrees < _FEWEST_LEFT:
            return None
        of_drift, of_stays, of_both = (degrees * np.log(max(each, 1e-300)) for each in left)
        if of_stays - of_both > _ADDS:
            return None
        known = StationChange()
        return ConfoundedEffect(
            name=STATION, parameters={}, evidence_behind=float(of_stays - of_drift), role="alias",
            separating_test=known.separating_test, separating_test_zh=known.separating_test_zh,
        )  # fmt: skip

    def _without_drifts(self, columns: FloatArray, day: FloatArray, drifting: BoolArray) -> FloatArray:
        """Columns less their drift over days in each of the `drifting` units."""
        squares = np.bincount(self.unit, day**2, len(drifting))
        products = np.array([np.bincount(self.unit, day * each, len(drifting)) for each in columns.T]).T
        slopes = np.where((drifting & (squares > 0.0))[:, None], products / np.maximum(squares, 1e-300)[:, None], 0.0)
        return np.asarray(columns - slopes[self.unit] * day[:, None])


def station_rival(
    units: Mapping[str, Sequence[RunBlocks]], stations: Mapping[str, Mapping[str, str]], model: ErrorModel
) -> StationRival | None:
    """What stations explain of the runs' constants; None where no run has a whole block.

    Parameters
    ----------
    stations: Of each unit, the station of each whole run.
    """
    rows = [
        (
            number,
            run.t0_ns + round(float(run.time_s.mean()) * 1e9),
            constant,
            stations.get(unit, {}).get(run.whole_run, ""),
        )
        for number, (unit, runs) in enumerate(units.items())
        for run, constant in run_constants(runs, model)
    ]
    if not rows:
        return None
    unit, t_ns, value = (np.array(each) for each in list(zip(*rows, strict=True))[:3])
    day = (t_ns - t_ns.min()) / _DAY_NS
    names, station = np.unique(np.array([name for *_, name in rows]), return_inverse=True)
    levels = within_units(np.asarray(station[:, None] == np.arange(1, names.size), np.float64), unit)
    step = _change(unit, day, station, value, levels)
    columns = levels if step is None else np.column_stack([levels, step])
    return StationRival(tuple(units), unit, day, value, columns)


def _change(
    unit: IntArray, day: FloatArray, station: IntArray, value: FloatArray, levels: FloatArray
) -> FloatArray | None:
    """Column of the change of one station that explains most of the constants; None where too few units cross any."""
    y = within_units(value[:, None], unit)
    found: list[tuple[float, FloatArray]] = []
    for number in np.unique(station):
        own = station == number
        days = np.unique(np.floor(day[own]))[1:]
        for since in days[:: 1 + len(days) // _MOST_CHANGES]:
            after = own & (day >= since)
            crossing = np.intersect1d(unit[after], unit[own & ~after])
            if crossing.size >= _FEWEST_UNITS:
                column = within_units(after.astype(np.float64)[:, None], unit)
                found.append((squares_left(np.hstack([levels, column]), y), column[:, 0]))
    return min(found, key=lambda each: each[0])[1] if found else None


def is_of_days(found: FoundEffect) -> bool:
    """Whether an effect is a drift over days."""
    return effect(found.name).needs == ("day",)


def within_units(columns: FloatArray, unit: IntArray) -> FloatArray:
    """Columns less their means over the rows of each unit."""
    counts = np.maximum(np.bincount(unit), 1)
    means = np.zeros((counts.size, columns.shape[1]))
    for at, each in enumerate(columns.T):
        means[:, at] = np.bincount(unit, each) / counts
    return np.asarray(columns - means[unit])


def squares_left(columns: FloatArray, value: FloatArray) -> float:
    """Sum of squares of a column that a least-squares fit of others leaves."""
    return float(np.sum((value - columns @ np.linalg.lstsq(columns, value, rcond=None)[0]) ** 2))


def with_station(diagnosis: Diagnosis, rival: StationRival | None, unit: str) -> Diagnosis:
    """The diagnosis of a unit, with the station as an alternative to each drift over days that it may explain."""
    effects = _beside(diagnosis.effects, rival, unit)
    if effects == diagnosis.effects:
        return diagnosis
    is_open = diagnosis.verdict is ModelVerdict.EFFECT_FOUND
    verdict = ModelVerdict.CONFOUNDED if is_open else diagnosis.verdict
    return msgspec.structs.replace(diagnosis, effects=effects, verdict=verdict)


def fleet_with_station(fleet: FleetDiagnosis, rival: StationRival | None) -> FleetDiagnosis:
    """The same of the effects that several units have in common, and of each unit."""
    effects = _beside(fleet.effects, rival, None)
    units = {unit: with_station(each, rival, unit) for unit, each in fleet.units.items()}
    is_open = effects != fleet.effects and fleet.verdict is ModelVerdict.EFFECT_FOUND
    verdict = ModelVerdict.CONFOUNDED if is_open else fleet.verdict
    return msgspec.structs.replace(fleet, effects=effects, units=units, verdict=verdict)


def _beside(effects: tuple[FoundEffect, ...], rival: StationRival | None, unit: str | None) -> tuple[FoundEffect, ...]:
    found = []
    for each in effects:
        other = None if rival is None else rival.rival_of(each, unit)
        confounded = each.confounded if other is None else (*each.confounded, other)
        found.append(msgspec.structs.replace(each, confounded=confounded))
    return tuple(found)
