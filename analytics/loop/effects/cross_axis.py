"""Rates about the other two axes that reach the output by misalignment."""

from analytics.loop.effects.monomial import Monomial


class CrossAxisO(Monomial):
    """Misalignment towards the output axis."""

    name = "cross_axis_o"
    en = "cross-axis rate, output axis"
    zh = "输出轴交叉耦合"
    needs = ("rate_o",)
    powers = (1,)
    per = "{rate_o}"
    cause = (
        "The input axis leans towards the output axis by a small angle. It then sees that part of the rate about the "
        "output axis."
    )
    cause_zh = "输入轴向输出轴方向有微小倾斜。因此输入轴敏感到输出轴角速率的一部分。"
    reference = "HIT 2012 (2)-(9); IEEE 952-2020, input axis misalignment; JJF 2014-2022"
    aliases = ("cross_axis_s", "table_rate")
    separating_test = "turn about the output axis at several rates with the input axis level"
    separating_test_zh = "输入轴水平放置，绕输出轴以多个角速率旋转"


class CrossAxisS(Monomial):
    """Misalignment towards the spin (reference) axis."""

    name = "cross_axis_s"
    en = "cross-axis rate, spin axis"
    zh = "自转轴交叉耦合"
    needs = ("rate_s",)
    powers = (1,)
    per = "{rate_s}"
    cause = (
        "The input axis leans towards the spin axis by a small angle. It then sees that part of the rate about the "
        "spin axis."
    )
    cause_zh = "输入轴向自转轴方向有微小倾斜。因此输入轴敏感到自转轴角速率的一部分。"
    reference = "HIT 2012 (2)-(9); IEEE 952-2020, input axis misalignment; JJF 2014-2022"
    aliases = ("cross_axis_o", "table_rate")
    separating_test = "turn about the spin axis at several rates with the input axis level"
    separating_test_zh = "输入轴水平放置，绕自转轴以多个角速率旋转"
