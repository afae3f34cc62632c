"""A jump of the bias at one moment of one run."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter
from analytics.loop.effects.shape_values import number
from stream.batch import FloatArray


class Jump(Effect):
    """Nothing before `at_s` of the run named in the shape, 1 from then on; nothing in other runs."""

    name = "jump"
    en = "bias jump"
    zh = "零偏跳变"
    needs = ()
    kind = Kind.EVENT
    parameters = (ShapeParameter("at_s", "s", (), "moment from the run's start", "距测试开始的时刻"),)
    cause = (
        "A mode hop of the source, a contact that slips or a change of state in the electronics shifts the bias at "
        "once. It happens at no set time, so that it cannot be replicated, only seen again."
    )
    cause_zh = "光源跳模、接触面滑移或电路状态切换使零偏突然移动。其发生时刻不定，无法复现，只能再次观察到。"
    reference = "IEEE 528-2019, random bias; GJB 2426A-2004, bias stability"
    aliases = ("temperature_threshold",)
    separating_test = "repeat the run several times and see whether it jumps at the same temperature, time or command"
    separating_test_zh = "多次重复测试，观察是否在相同温度、时间或指令处跳变"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        if shape.get("run") != run.run:
            return np.zeros((len(run), 1))
        end_s = (run.slot + 1) * run.block_s
        share = np.clip((end_s - number(shape, "at_s")) / run.block_s, 0.0, 1.0)
        return np.asarray(share, np.float64)[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        return np.where(time_s >= number(shape, "at_s"), coefficients[0], 0.0)
