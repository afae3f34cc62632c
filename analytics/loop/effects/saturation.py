"""Large rates that the gyro cuts off."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from analytics.loop.effects.within_block import mean_excess, mirrored
from stream.batch import FloatArray


class Saturation(Effect):
    """Error in proportion to what of the input rate lies beyond `limit`, in its direction."""

    name = "saturation"
    en = "saturation at large rates"
    zh = "大角速率饱和"
    needs = ("input_rate",)
    parameters = (
        ShapeParameter(
            "limit",
            "{input_rate}",
            (0.2, 0.25, 0.3, 0.35, 0.4, 0.45),
            "rate at which it begins",
            "饱和起点",
            "input_rate",
        ),
    )
    per = "{input_rate}"
    cause = (
        "Amplifier, converter or loop reach their limit and follow the rate no further, or with less gain. The error "
        "is zero up to that rate and grows in proportion beyond it."
    )
    cause_zh = "放大器、转换器或环路达到极限，不再跟随角速率或增益下降。误差在该角速率以下为零，以上成比例增长。"
    reference = "IEEE 528-2019, input rate limits; IEEE 952-2020; GJB 2426A-2004, maximum input rate"
    aliases = ("scale_factor_cubic",)
    separating_test = "several rates in both directions between half and the whole of the greatest rate"
    separating_test_zh = "在最大角速率的一半至全值之间正反向取若干档"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        rate, limit = run.channels["input_rate"], positive(shape, "limit")
        return (mean_excess(rate, limit) - mean_excess(mirrored(rate), limit))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        rate, limit = channels["input_rate"], positive(shape, "limit")
        return coefficients[0] * (rate - np.clip(rate, -limit, limit))
