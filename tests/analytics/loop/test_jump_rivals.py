"""A jump that coincides with a step of a recorded channel is not a mode hop of the source alone."""

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.reduction_notes import OUTPUT, Note
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.unread_outputs import with_unread_outputs
from tests.analytics.loop.block_runs import BLOCK_S, BLOCKS, WHITE, run_of, warming

NOISE = ModelNoise(N=WHITE * float(np.sqrt(BLOCK_S / 3600.0)), B=0.003, K=0.003, turn_on=0.01)


def found(step_at: int) -> Diagnosis:
    """Six runs, in one of which the output jumps after 1200 s, and in all of which an unknown channel steps."""
    rng = np.random.default_rng(31)
    blocks, runs = np.arange(BLOCKS), []
    for number in range(6):
        across = np.where(blocks >= step_at, 5.0, 0.0) + 1e-4 * rng.standard_normal(BLOCKS)
        error = np.where((number == 2) & (blocks >= 40), 1.0, 0.0)
        runs.append(run_of(rng, number, error, {"temperature": warming(number), "rate_y": across}))
    return diagnose(runs, ErrorModel.parse("rate = bias"), declared_noise=NOISE)


def test_the_channel_that_steps_is_named() -> None:
    together, apart = found(step_at=40), found(step_at=25)
    for each in (together, apart):
        assert [effect.name for effect in each.effects] == ["jump"]
    assert together.effects[0].coincides == ("rate_y",)
    assert "which these data cannot separate from the steps of rate_y at that time" in verdict_sentence(
        together, Wording("en")
    )
    assert "无法与rate_y同时发生的阶跃区分" in verdict_sentence(together, Wording("zh"))
    assert apart.effects[0].coincides == ()
    assert "cannot separate" not in verdict_sentence(apart, Wording("en"))


def test_outputs_that_are_not_read_are_named_beside_a_jump() -> None:
    jumped = found(step_at=25)
    note = Note(OUTPUT, Bilingual("rate_y of U1 are outputs like rate and not channels", "U1的rate_y为产品输出"))
    assert "rate_y" in with_unread_outputs(jumped, [note]).limits[-1]
    assert with_unread_outputs(jumped, []).limits == jumped.limits
