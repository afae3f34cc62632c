"""The verdict on a fleet goes with those of its units beside it."""

import numpy as np
import pytest

from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.finding_sentences import fleet_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.fleet import diagnose_fleet
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from tests.analytics.loop.block_runs import BLOCK_S, WHITE, run_of, warming

NOISE = ModelNoise(N=WHITE * np.sqrt(BLOCK_S / 3600.0), B=0.003, K=0.003, turn_on=0.01)
LACKING = "no missing effect in common that repeats in their runs; of the units alone, temperature is missing in "


@pytest.mark.long
@pytest.mark.parametrize(
    ("per_deg_c", "verdict", "text"),
    [
        ((0.02, -0.02, 0.0), ModelVerdict.UNREPLICATED, LACKING + "U0 and U1."),
        ((0.0, 0.0, 0.0), ModelVerdict.NOTHING_MISSING, "no missing effect in common that repeats in their runs."),
    ],
)
def test_units_that_lack_something_of_their_own_are_not_nothing_missing(
    per_deg_c: tuple[float, ...], verdict: ModelVerdict, text: str
) -> None:
    rng = np.random.default_rng(1)
    units = {
        f"U{unit}": [
            run_of(rng, number, size * (warming(number) - 25.0), {"temperature": warming(number)}, f"U{unit}")
            for number in range(6)
        ]
        for unit, size in enumerate(per_deg_c)
    }
    found = diagnose_fleet(units, ErrorModel.parse("rate = bias"), declared_noise=dict.fromkeys(units, NOISE))
    assert found.verdict is verdict
    assert fleet_sentence(found, Wording("en", units["U0"][0])) == f"The 3 units have {text}"


def test_more_noise_than_declared_in_a_unit_is_not_nothing_missing() -> None:
    rng = np.random.default_rng(2)
    units = {
        f"U{unit}": [
            run_of(rng, number, np.zeros(80), {"temperature": warming(number)}, f"U{unit}", WHITE * size)
            for number in range(4)
        ]
        for unit, size in enumerate((3.0, 1.0))
    }
    found = diagnose_fleet(units, ErrorModel.parse("rate = bias"), declared_noise=dict.fromkeys(units, NOISE))
    assert [each.verdict for each in found.units.values()] == [ModelVerdict.UNEXPLAINED, ModelVerdict.NOTHING_MISSING]
    assert found.verdict is ModelVerdict.UNEXPLAINED
    assert "in U0 something is left that no effect explains" in fleet_sentence(found, Wording("en", units["U0"][0]))
