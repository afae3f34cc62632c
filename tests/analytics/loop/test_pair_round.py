"""Two effects that mask each other are found together; one effect, and none, stay what they are."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effects_for
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.diagnosis import FIRST_TIER, diagnose
from analytics.loop.tracing.search.pair_round import best_pair
from analytics.loop.tracing.search.screening import candidates_for
from analytics.loop.tracing.whitening.joint_fit import fit_jointly, nothing_more
from stream.batch import FloatArray
from tests.bench.loop_campaign import Campaign, DenseWhitener, Planted
from tests.bench.tracing_cases import DECLARED, MODEL

HYSTERESIS: tuple[str, dict[str, float]] = ("thermal_hysteresis", {"width": 6.0})
GRADIENT: tuple[str, dict[str, float]] = ("temperature_gradient", {})
TOGETHER_Z = 8.9


def masked(campaign: Campaign) -> tuple[list[RunBlocks], float]:
    """Two effects of opposite sign that the ideal fit sees with z = 8.9 together; the z of each alone."""
    clean = campaign.runs(noiseless=True)
    training = [clean[number] for number in campaign.training]
    whiten = DenseWhitener([campaign.slots[number] for number in campaign.training], campaign.block_s, campaign.noise)
    known = [
        np.column_stack([np.ones(len(run)), run.mean("input_rate"), run.mean("temperature") - 25.0]) for run in training
    ]
    both = [_added(campaign, name, shape) for name, shape in (HYSTERESIS, GRADIENT)]
    white = whiten(np.column_stack([np.concatenate(known), *both]))
    basis, _ = np.linalg.qr(white[:, :3] / np.linalg.norm(white[:, :3], axis=0))
    left = white[:, 3:] - basis @ (basis.T @ white[:, 3:])
    sizes = np.linalg.norm(left, axis=0)
    alike = float(left[:, 0] @ left[:, 1] / sizes.prod())
    each = TOGETHER_Z / np.sqrt(2 - 2 * abs(alike)) / sizes * np.array([1.0, -np.sign(alike)])
    alone = float(np.abs((left @ each) @ left[:, 0]) / sizes[0])
    planted = [
        Planted(name, [float(size)], shape) for (name, shape), size in zip((HYSTERESIS, GRADIENT), each, strict=True)
    ]
    return campaign.runs(planted), alone


def _added(campaign: Campaign, name: str, shape: dict[str, float]) -> FloatArray:
    added = campaign.added(Planted(name, [1.0], shape))
    return np.concatenate([added[number] for number in campaign.training])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long), pytest.param(3, marks=pytest.mark.long)])
def test_two_effects_that_mask_each_other_are_found_by_a_pairwise_round(seed: int) -> None:
    runs, alone = masked(Campaign(seed))
    assert alone < 3.5  # neither passes by itself
    found = diagnose(runs, MODEL, declared_noise=DECLARED)
    meant = [{each.name, *(other.name for other in each.confounded)} for each in found.effects]
    assert len(meant) == 2
    assert any("thermal_hysteresis" in names for names in meant)
    assert any("temperature_gradient" in names for names in meant)
    assert all(each.confirmed for each in found.effects)


@pytest.mark.long
def test_no_pair_is_made_of_noise_or_of_one_effect() -> None:
    campaign = Campaign(4)
    for planted in ([], [Planted("gravity_o", campaign.coefficients_for("gravity_o", {}, 10.0))]):
        case = case_of(campaign.runs(planted), MODEL, DECLARED)
        records = [case.training]
        candidates = candidates_for(records, effects_for(case.stack.runs), MODEL, FIRST_TIER, {})
        null = fit_jointly(records, nothing_more(records))
        assert best_pair(candidates, null, lambda: 50.0) == []
