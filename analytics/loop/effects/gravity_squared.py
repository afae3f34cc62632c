"""Bias as the square of gravity along one axis."""

from analytics.loop.effects.monomial import Monomial

_REFERENCE = "IEEE 1431-2004, acceleration-squared sensitivity; IEEE 517-1974, compliance (anisoelastic) terms"
_TEST = "tumble in 12 positions, and again under centrifuge load so that the squares do not add up to one"
_TEST_ZH = "十二位置翻滚试验，并在离心机上加载，使三个平方之和不恒为一"


class GravityISquared(Monomial):
    """Of gravity along the input axis."""

    name = "gravity_i_squared"
    en = "gravity squared, input axis"
    zh = "输入轴重力平方项"
    needs = ("gravity_i",)
    powers = (2,)
    per = "{gravity_i}^2"
    cause = (
        "The sensing part gives way under load along the input axis, and the load acts on what has given way. Both "
        "signs of gravity shift the bias alike."
    )
    cause_zh = "敏感部件沿输入轴受载变形，载荷又作用在变形上。重力正反向引起的零偏变化同号。"
    reference = _REFERENCE
    aliases = ("gravity_o_squared", "gravity_s_squared")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH


class GravityOSquared(Monomial):
    """Of gravity along the output axis."""

    name = "gravity_o_squared"
    en = "gravity squared, output axis"
    zh = "输出轴重力平方项"
    needs = ("gravity_o",)
    powers = (2,)
    per = "{gravity_o}^2"
    cause = (
        "The sensing part gives way under load along the output axis, and the load acts on what has given way. Both "
        "signs of gravity shift the bias alike."
    )
    cause_zh = "敏感部件沿输出轴受载变形，载荷又作用在变形上。重力正反向引起的零偏变化同号。"
    reference = _REFERENCE
    aliases = ("gravity_i_squared", "gravity_s_squared")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH


class GravitySSquared(Monomial):
    """Of gravity along the spin axis."""

    name = "gravity_s_squared"
    en = "gravity squared, spin axis"
    zh = "自转轴重力平方项"
    needs = ("gravity_s",)
    powers = (2,)
    per = "{gravity_s}^2"
    cause = (
        "The sensing part gives way under load along the spin axis, and the load acts on what has given way. Both "
        "signs of gravity shift the bias alike."
    )
    cause_zh = "敏感部件沿自转轴受载变形，载荷又作用在变形上。重力正反向引起的零偏变化同号。"
    reference = _REFERENCE
    aliases = ("gravity_i_squared", "gravity_o_squared")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH
