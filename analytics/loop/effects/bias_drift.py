"""Bias that drifts in one direction: over days, and within each run."""

from collections.abc import Sequence

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Shape
from analytics.loop.effects.monomial import Monomial
from stream.batch import FloatArray

EFFECTS = (
    Monomial(
        name="ageing",
        en="ageing over days",
        zh="长期老化",
        powers={"day": 1},
        per="day",
        cause="Source power, adhesive and getter age over days to years, on the shelf and in use. The bias shifts "
        "from run to run in one direction.",
        cause_zh="光源功率、胶粘剂和吸气剂在存放与使用中逐日老化。零偏在各次测试之间朝一个方向移动。",
        reference="IEEE 952-2020, bias stability over time; GJB 2426A-2004, long-term repeatability",
        aliases=("drift_in_run",),
        separating_test="repeat the same power-on test on eight or more days spread over weeks",
        separating_test_zh="在数周内分八天以上重复同样的通电测试",
    ),
)


class DriftInRun(Effect):
    """Bias in proportion to the time since the run's start, alike in every run."""

    name = "drift_in_run"
    en = "drift within the run"
    zh = "测试内漂移"
    needs = ()
    per = "h"
    cause = (
        "A relaxation such as outgassing or the decay of mounting stress proceeds in the same direction in each run. "
        "Over hours it appears as a rate ramp."
    )
    cause_zh = "每次测试中某些因素（放气、装夹应力等）沿同一方向松弛。数小时内表现为速率斜坡。"
    reference = "IEEE 952-2020, rate ramp; IEEE 528-2019"
    aliases = ("warm_up", "temperature", "ageing")
    separating_test = "long static run at constant temperature, started at different times after power-on"
    separating_test_zh = "恒温长时间静态测试，并在通电后不同时间开始"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (run.time_s / 3600.0)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return coefficients[0] / 3600.0 * time_s
