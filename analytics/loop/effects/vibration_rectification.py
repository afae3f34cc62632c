"""Bias that vibration gives rise to."""

from analytics.loop.effects.monomial import Monomial


class Vibration(Monomial):
    """In proportion to the level of vibration."""

    name = "vibration"
    en = "vibration level"
    zh = "振动量级（一次项）"
    needs = ("vibration",)
    powers = (1,)
    per = "{vibration}"
    cause = (
        "Rubbing contacts and loose parts shift as soon as there is vibration, about in proportion to its level. The "
        "bias follows the level, not its direction."
    )
    cause_zh = "摩擦接触面与松动件在振动下移动，大致与量级成正比。零偏随量级变化而与方向无关。"
    reference = "IEEE 1431-2004, vibration sensitivity; JJF 2014-2022, vibration"
    aliases = ("vibration_squared",)
    separating_test = "four or more levels of the same random vibration, the first one repeated at the end"
    separating_test_zh = "同一随机振动谱取四个以上量级，最后重复第一量级"


class VibrationSquared(Monomial):
    """As the square of the level of vibration: rectification."""

    name = "vibration_squared"
    en = "vibration rectification"
    zh = "振动整流误差"
    needs = ("vibration",)
    powers = (2,)
    per = "{vibration}^2"
    cause = (
        "Compliance and demodulation multiply the vibration with itself, which leaves a mean. The bias is in "
        "proportion to mean-square acceleration."
    )
    cause_zh = "柔度和解调使振动自身相乘，留下直流分量。零偏与加速度均方值成正比。"
    reference = "IEEE 1431-2004, vibration rectification; IEEE 517-1974"
    aliases = ("vibration",)
    separating_test = "four or more levels of the same random vibration, the first one repeated at the end"
    separating_test_zh = "同一随机振动谱取四个以上量级，最后重复第一量级"
