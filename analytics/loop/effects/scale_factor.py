"""Error in proportion to the input rate: the declared scale factor is not the true one."""

from analytics.loop.effects.monomial import Monomial


class ScaleFactor(Monomial):
    """Output in proportion to the rate about the input axis; mostly declared."""

    name = "scale_factor"
    en = "scale factor"
    zh = "标度因数"
    needs = ("input_rate",)
    powers = (1,)
    per = "{input_rate}"
    cause = (
        "The gyro turns rate into output with a factor set by coil area, wavelength and gain. Where this factor "
        "differs from the one that is used, the error grows with the rate."
    )
    cause_zh = "陀螺以由环面积、波长和增益决定的系数把角速率变为输出。该系数与所用值不符时，误差与角速率成正比。"
    reference = "IEEE 952-2020, scale factor; GJB 2426A-2004 5.8; JJF 2014-2022 7.2.1"
    aliases = ("table_rate",)
    separating_test = "turn at several rates in both directions about the input axis only"
    separating_test_zh = "仅绕输入轴以多个角速率正反向旋转"
