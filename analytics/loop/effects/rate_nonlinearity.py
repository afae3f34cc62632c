"""Curvature of the output over the input rate."""

from analytics.loop.effects.monomial import Monomial


class ScaleFactorQuadratic(Monomial):
    """Error as the square of the input rate, k_II of the HIT 2012 model."""

    name = "scale_factor_quadratic"
    en = "square of the input rate"
    zh = "输入角速率二次项"
    needs = ("input_rate",)
    powers = (2,)
    per = "{input_rate}^2"
    cause = (
        "Demodulation offset and anisoinertia rectify the rate, so that both directions of turning give an error of "
        "one sign. It grows with the square of the rate."
    )
    cause_zh = "解调偏置和惯性不等使角速率产生整流，正反转误差同号。该误差与角速率平方成正比。"
    reference = "HIT 2012 (2), term k_II; IEEE 517-1974, anisoinertia"
    aliases = ("scale_factor_asymmetry", "rate_product_io", "rate_product_is")
    separating_test = "three or more rates for each direction"
    separating_test_zh = "每个方向至少三个角速率"


class ScaleFactorCubic(Monomial):
    """Error as the cube of the input rate."""

    name = "scale_factor_cubic"
    en = "cube of the input rate"
    zh = "输入角速率三次项"
    needs = ("input_rate",)
    powers = (3,)
    per = "{input_rate}^3"
    cause = (
        "A closed loop of finite gain and a sine-shaped detector compress large rates alike in both directions. The "
        "lowest order that keeps the direction is the cube."
    )
    cause_zh = "有限环路增益和正弦型检测特性对大角速率产生对称压缩。保持方向的最低阶为三次项。"
    reference = "IEEE 952-2020, scale-factor nonlinearity; GJB 2426A-2004 5.8; Lefevre, The Fiber-Optic Gyroscope, 2014"
    aliases = ("saturation", "dead_zone")
    separating_test = "three or more rates for each direction up to the greatest"
    separating_test_zh = "每个方向至少三个角速率，直至最大角速率"
