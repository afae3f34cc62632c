"""Bias as the product of gravity along two axes."""

from analytics.loop.effects.monomial import Monomial

_REFERENCE = "IEEE 517-1974, compliance (anisoelastic) terms; IEEE 1431-2004, acceleration-squared sensitivity"


class GravityProductIO(Monomial):
    """Of input and output axis."""

    name = "gravity_product_io"
    en = "gravity product, input and output axis"
    zh = "输入轴与输出轴重力乘积项"
    needs = ("gravity_i", "gravity_o")
    powers = (1, 1)
    per = "{gravity_i}*{gravity_o}"
    cause = (
        "Load along one axis displaces the sensing part, and load along the other turns that displacement into a "
        "torque. It is greatest at 45 deg between both axes."
    )
    cause_zh = "一轴载荷使敏感部件位移，另一轴载荷把该位移变为力矩。两轴成45度时最大。"
    reference = _REFERENCE
    aliases = ("gravity_i", "gravity_o")
    separating_test = "tumble with positions at 45 deg between input and output axis, in all four quadrants"
    separating_test_zh = "翻滚试验中增加输入轴与输出轴间四个象限的45度位置"


class GravityProductIS(Monomial):
    """Of input and spin axis."""

    name = "gravity_product_is"
    en = "gravity product, input and spin axis"
    zh = "输入轴与自转轴重力乘积项"
    needs = ("gravity_i", "gravity_s")
    powers = (1, 1)
    per = "{gravity_i}*{gravity_s}"
    cause = (
        "Anisoelasticity: the sensing part gives way differently along input and spin axis, and gravity acts on the "
        "offset. It is greatest at 45 deg between both axes."
    )
    cause_zh = "不等弹性：敏感部件沿输入轴与自转轴的柔度不同，重力作用于由此产生的偏移。两轴成45度时最大。"
    reference = _REFERENCE
    aliases = ("gravity_i", "gravity_s")
    separating_test = "tumble with positions at 45 deg between input and spin axis, in all four quadrants"
    separating_test_zh = "翻滚试验中增加输入轴与自转轴间四个象限的45度位置"


class GravityProductOS(Monomial):
    """Of output and spin axis."""

    name = "gravity_product_os"
    en = "gravity product, output and spin axis"
    zh = "输出轴与自转轴重力乘积项"
    needs = ("gravity_o", "gravity_s")
    powers = (1, 1)
    per = "{gravity_o}*{gravity_s}"
    cause = (
        "Load along the output axis displaces the sensing part, and load along the spin axis turns that displacement "
        "into a torque. It is greatest at 45 deg between both axes."
    )
    cause_zh = "输出轴载荷使敏感部件位移，自转轴载荷把该位移变为力矩。两轴成45度时最大。"
    reference = _REFERENCE
    aliases = ("gravity_o", "gravity_s")
    separating_test = "tumble with positions at 45 deg between output and spin axis, in all four quadrants"
    separating_test_zh = "翻滚试验中增加输出轴与自转轴间四个象限的45度位置"
