"""A drift over days is not put on units where stations explain it as well; their levels are no turn-on scatter."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from scipy.stats import binom

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.events import STATION
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.station_levels import with_station_levels
from analytics.loop.station_rival import fleet_with_station, station_rival, with_station
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from stream.batch import FloatArray

DAY_NS = 86_400 * 10**9
START_NS = 1_763_683_200 * 10**9
UNITS, RUNS, BLOCKS = 8, 8, 20
AGEING = FoundEffect(name="ageing", parameters={}, coefficients=(), significance=9.0, evidence=70.0, roles={})
FOUND = Diagnosis(verdict=ModelVerdict.EFFECT_FOUND, units=("U0",), signal="rate", effects=(AGEING,))
BOTH, FIRST_THEN_SECOND, ONE = "ABABABAB", "AAAABBBB", "AAAAAAAA"


def records(bias: Callable[[int, int], float]) -> dict[str, list[RunBlocks]]:
    """Runs, six days apart, of units whose bias is a function of the unit and the day."""
    rng = np.random.default_rng(3)
    ones = np.ones(BLOCKS)
    return {
        f"U{unit}": [
            RunBlocks(
                f"U{unit}", f"r{run}", "rate", np.arange(BLOCKS), 30.0, START_NS + 6 * run * DAY_NS,
                bias(unit, 6 * run) + rng.normal(0, 0.05) + rng.normal(0, 0.05, BLOCKS), ones.astype(int), ones,
                "deg/h",
            )
            for run in range(RUNS)
        ]
        for unit in range(UNITS)
    }  # fmt: skip


@pytest.mark.parametrize(
    ("bias", "stations", "is_rival"),
    [
        (lambda unit, day: unit + 0.3 * (day >= 24), FIRST_THEN_SECOND, True),
        (lambda unit, day: unit + 0.3 * (day % 12 > 0 and day >= 24), BOTH, True),  # the second station changes
        (lambda unit, day: unit + 0.3 * (day >= 24), ONE, True),
        (lambda unit, day: unit + 0.2 * (day % 12 > 0) + 0.01 * day, BOTH, False),
        (lambda unit, day: unit + 0.01 * day, ONE, False),
    ],
)
def test_a_station_is_a_rival_of_ageing_where_it_explains_the_runs(
    bias: Callable[[int, int], float], stations: str, *, is_rival: bool
) -> None:
    units = records(bias)
    measured_at = {unit: {run.run: stations[at] for at, run in enumerate(runs)} for unit, runs in units.items()}
    rival = station_rival(units, measured_at, ErrorModel.parse("bias"))
    fleet = FleetDiagnosis(
        verdict=ModelVerdict.EFFECT_FOUND, effects=(AGEING,), units=dict.fromkeys(units, FOUND), own_findings={}
    )
    found = fleet_with_station(fleet, rival)
    assert [other.name for other in found.effects[0].confounded] == [STATION] * is_rival
    assert found.verdict is (ModelVerdict.CONFOUNDED if is_rival else ModelVerdict.EFFECT_FOUND)


def test_a_unit_that_ages_beside_a_station_that_changes_keeps_its_ageing() -> None:
    units = records(lambda unit, day: unit + 0.3 * (day % 12 > 0 and day >= 24) + 0.02 * day * (unit == 0))
    measured_at = {unit: {run.run: BOTH[at] for at, run in enumerate(runs)} for unit, runs in units.items()}
    rival = station_rival(units, measured_at, ErrorModel.parse("bias"))
    assert with_station(FOUND, rival, "U0") == FOUND
    assert with_station(FOUND, rival, "U1").verdict is ModelVerdict.CONFOUNDED


def test_what_is_no_drift_over_days_has_no_station_beside_it() -> None:
    units = records(lambda unit, day: unit + 0.3 * (day >= 24))
    rival = station_rival(units, {}, ErrorModel.parse("bias"))
    other = msgspec.structs.replace(FOUND, effects=(msgspec.structs.replace(AGEING, name="temperature_squared"),))
    assert with_station(other, rival, "U0") == other
    assert with_station(FOUND, None, "U0") == FOUND


NOTHING = Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, units=("U0",), signal="rate")
MODEL = ErrorModel.parse("bias")


def test_biases_that_differ_by_station_are_not_nothing_missing() -> None:
    runs = records(lambda unit, day: unit + 0.3 * (day % 12 > 0))["U0"]
    measured_at = {run.run: BOTH[at] for at, run in enumerate(runs)}
    found = with_station_levels(NOTHING, runs, measured_at, MODEL)
    assert (found.verdict, [each.name for each in found.unreplicated]) == (ModelVerdict.UNREPLICATED, [STATION])
    (size,) = found.unreplicated[0].coefficients
    assert (size.name, size.unit_of_measure) == ("B \N{MINUS SIGN} A", "deg/h")
    assert size.lo < 0.3 < size.hi
    assert "the biases of the 8 runs differ by station: B" in verdict_sentence(found, Wording("en"))
    assert "8次试验的零偏随试验台而异" in verdict_sentence(found, Wording("zh"))
    for stations in ({}, dict.fromkeys(measured_at, "A")):
        assert with_station_levels(NOTHING, runs, stations, MODEL) == NOTHING
    assert with_station_levels(FOUND, runs, measured_at, MODEL) == FOUND


def test_stations_are_accused_no_more_often_than_promised() -> None:
    """Biases that scatter alike at three stations: 1 in 100 by chance."""
    accused = units = 0
    rng = np.random.default_rng(7)
    for _ in range(25):
        bias = rng.normal(0, 0.2, (UNITS, RUNS))

        def of_day(unit: int, day: int, bias: FloatArray = bias) -> float:
            return float(bias[unit, day // 6])

        for runs in records(of_day).values():
            measured_at = {run.run: "ABCABCAB"[at] for at, run in enumerate(runs)}
            found = with_station_levels(NOTHING, runs, measured_at, MODEL)
            accused += found.verdict is not ModelVerdict.NOTHING_MISSING
            units += 1
    assert accused <= binom.ppf(0.999, units, 0.01)
