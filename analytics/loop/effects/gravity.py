"""Bias by gravity: along one axis, squared, and the product of two axes."""

from itertools import combinations

from analytics.loop.effects.channel_names import AXES, Axis
from analytics.loop.effects.monomial import Monomial

_LINEAR = {
    "i": (
        "gravity_i_squared",
        (
            "Gravity along the input axis loads the suspension or the coil and shifts the bias. An error in the "
            "compensation of the vertical earth rate follows the same cosine."
        ),
        "沿输入轴的重力使支承或光纤环受力，零偏移动。地速垂直分量补偿不准时也呈同样的余弦规律。",
    ),
    "o": (
        "gravity_product_io",
        (
            "Gravity along the output axis bends flexleads or strains the coil sideways. The bias shifts with the "
            "sine of the tilt."
        ),
        "沿输出轴的重力使软导线弯曲或光纤环侧向受力。零偏随倾角正弦变化。",
    ),
    "s": (
        "gravity_product_is",
        (
            "Mass unbalance of the sensing element along the spin axis turns gravity into a torque. The bias shifts "
            "with the sine of the tilt."
        ),
        "敏感部件沿自转轴的质量不平衡把重力变为力矩。零偏随倾角正弦变化。",
    ),
}
"""By axis: a further alias, and the cause in both languages."""
_PRODUCTS = {
    "io": (
        (
            "Load along one axis displaces the sensing element, and load along the other turns that displacement into "
            "a torque."
        ),
        "一轴载荷使敏感部件位移，另一轴载荷把该位移变为力矩。",
    ),
    "is": (
        (
            "Anisoelasticity: the compliance of the sensing element differs between input and spin axis, and gravity "
            "acts on the resulting displacement."
        ),
        "不等弹性：敏感部件沿输入轴与自转轴的柔度不同，重力作用于由此产生的偏移。",
    ),
    "os": (
        (
            "Load along the output axis displaces the sensing element, and load along the spin axis turns that "
            "displacement into a torque."
        ),
        "输出轴载荷使敏感部件位移，自转轴载荷把该位移变为力矩。",
    ),
}
"""By pair of axes: the cause in both languages."""


def _linear(axis: Axis) -> Monomial:
    alias, cause, cause_zh = _LINEAR[axis.key]
    return Monomial(
        name=f"gravity_{axis.key}",
        en=f"gravity, {axis.en}",
        zh=f"{axis.zh}重力敏感项",
        cause=cause,
        cause_zh=cause_zh,
        reference="IEEE 1431-2004, acceleration sensitivity; IEEE 517-1974, mass unbalance; GJB 2426A-2004",
        aliases=(alias, "heading"),
        separating_test="12-position tumble test at two headings",
        separating_test_zh="两个方位下的十二位置翻滚试验",
    )


def _squared(axis: Axis) -> Monomial:
    return Monomial(
        name=f"gravity_{axis.key}_squared",
        en=f"gravity squared, {axis.en}",
        zh=f"{axis.zh}重力平方项",
        powers={f"gravity_{axis.key}": 2},
        cause=f"The sensing element deflects under load along the {axis.en}, and the load acts on that deflection. "
        "Gravity of either sign shifts the bias in the same direction.",
        cause_zh=f"敏感部件沿{axis.zh}受载变形，载荷又作用在变形上。重力正反向引起的零偏变化同号。",
        reference="IEEE 1431-2004, acceleration-squared sensitivity; IEEE 517-1974, compliance (anisoelastic) terms",
        aliases=tuple(f"gravity_{other.key}_squared" for other in AXES if other != axis),
        separating_test="12-position tumble test, repeated under centrifuge load so that the sum of the squares is "
        "not constant",
        separating_test_zh="十二位置翻滚试验，并在离心机上加载，使三个平方之和不恒为一",
    )


def _product(one: Axis, other: Axis) -> Monomial:
    cause, cause_zh = _PRODUCTS[one.key + other.key]
    pair, channels = f"{one.en.removesuffix(' axis')} and {other.en}", (f"gravity_{one.key}", f"gravity_{other.key}")
    return Monomial(
        name=f"gravity_product_{one.key}{other.key}",
        en=f"gravity product, {pair}",
        zh=f"{one.zh}与{other.zh}重力乘积项",
        powers=dict.fromkeys(channels, 1),
        cause=f"{cause} The effect is greatest at 45 deg between the two axes.",
        cause_zh=f"{cause_zh}两轴成45度时最大。",
        reference="IEEE 517-1974, compliance (anisoelastic) terms; IEEE 1431-2004, acceleration-squared sensitivity",
        aliases=channels,
        separating_test=f"tumble test with positions at 45 deg between {pair}, in all four quadrants",
        separating_test_zh=f"翻滚试验中增加{one.zh}与{other.zh}间四个象限的45度位置",
    )


EFFECTS = (
    *(_linear(axis) for axis in AXES),
    *(_squared(axis) for axis in AXES),
    *(_product(one, other) for one, other in combinations(AXES, 2)),
)
