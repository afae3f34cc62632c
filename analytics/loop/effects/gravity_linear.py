"""Bias in proportion to gravity along one axis."""

from analytics.loop.effects.monomial import Monomial

_REFERENCE = "IEEE 1431-2004, acceleration sensitivity; IEEE 517-1974, mass unbalance; GJB 2426A-2004"


class GravityI(Monomial):
    """Along the input axis."""

    name = "gravity_i"
    en = "gravity, input axis"
    zh = "输入轴重力敏感项"
    needs = ("gravity_i",)
    powers = (1,)
    per = "{gravity_i}"
    cause = (
        "Gravity along the input axis loads the suspension or the coil and shifts the bias. The vertical part of the "
        "earth's rate, if it is not taken off rightly, follows the same cosine."
    )
    cause_zh = "沿输入轴的重力使支承或光纤环受力，零偏移动。地速垂直分量补偿不准时也呈同样的余弦规律。"
    reference = _REFERENCE
    aliases = ("gravity_i_squared", "heading")
    separating_test = "tumble in 12 positions at two headings"
    separating_test_zh = "两个方位下的十二位置翻滚试验"


class GravityO(Monomial):
    """Along the output axis."""

    name = "gravity_o"
    en = "gravity, output axis"
    zh = "输出轴重力敏感项"
    needs = ("gravity_o",)
    powers = (1,)
    per = "{gravity_o}"
    cause = (
        "Gravity along the output axis bends flexleads or strains the coil sideways. The bias shifts with the sine of "
        "the tilt."
    )
    cause_zh = "沿输出轴的重力使软导线弯曲或光纤环侧向受力。零偏随倾角正弦变化。"
    reference = _REFERENCE
    aliases = ("gravity_product_io", "heading")
    separating_test = "tumble in 12 positions at two headings"
    separating_test_zh = "两个方位下的十二位置翻滚试验"


class GravityS(Monomial):
    """Along the spin (reference) axis."""

    name = "gravity_s"
    en = "gravity, spin axis"
    zh = "自转轴重力敏感项"
    needs = ("gravity_s",)
    powers = (1,)
    per = "{gravity_s}"
    cause = (
        "Mass unbalance of the sensing part along the spin axis turns gravity into a torque. The bias shifts with the "
        "sine of the tilt."
    )
    cause_zh = "敏感部件沿自转轴的质量不平衡把重力变为力矩。零偏随倾角正弦变化。"
    reference = _REFERENCE
    aliases = ("gravity_product_is", "heading")
    separating_test = "tumble in 12 positions at two headings"
    separating_test_zh = "两个方位下的十二位置翻滚试验"
