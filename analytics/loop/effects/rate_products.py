"""Products of rates about two axes, as in the model of HIT 2012."""

from analytics.loop.effects.monomial import Monomial


class RateProductIO(Monomial):
    """Input rate times rate about the output axis, k_IO."""

    name = "rate_product_io"
    en = "input rate times output-axis rate"
    zh = "输入轴与输出轴角速率乘积"
    needs = ("input_rate", "rate_o")
    powers = (1, 1)
    per = "{input_rate}*{rate_o}"
    cause = (
        "Unequal inertia and the float's tilt under rate couple two axes. The torque, and so the error, is a product "
        "of both rates."
    )
    cause_zh = "惯量不等和浮子在角速率下的倾斜使两轴耦合。力矩及误差为两个角速率的乘积。"
    reference = "HIT 2012 (2), term k_Io; IEEE 517-1974, cross coupling"
    aliases = ("scale_factor_quadratic",)
    separating_test = "turn about an axis between input and output axis, at both signs of the tilt"
    separating_test_zh = "绕输入轴与输出轴之间的倾斜轴旋转，倾斜取正负两种"


class RateProductIS(Monomial):
    """Input rate times rate about the spin axis, k_IS."""

    name = "rate_product_is"
    en = "input rate times spin-axis rate"
    zh = "输入轴与自转轴角速率乘积"
    needs = ("input_rate", "rate_s")
    powers = (1, 1)
    per = "{input_rate}*{rate_s}"
    cause = (
        "The loop holds the float off null in proportion to the input rate, which turns the input axis towards the "
        "spin axis. The rate about the spin axis then enters as a product."
    )
    cause_zh = "输入角速率使浮子偏离零位，输入轴向自转轴偏转。自转轴角速率因此以乘积形式进入输出。"
    reference = "HIT 2012 (2), term k_Is; IEEE 517-1974, cross coupling"
    aliases = ("scale_factor_quadratic",)
    separating_test = "turn about an axis between input and spin axis, at both signs of the tilt"
    separating_test_zh = "绕输入轴与自转轴之间的倾斜轴旋转，倾斜取正负两种"


class RateProductOS(Monomial):
    """Rate about the output axis times rate about the spin axis, k_OS."""

    name = "rate_product_os"
    en = "output-axis rate times spin-axis rate"
    zh = "输出轴与自转轴角速率乘积"
    needs = ("rate_o", "rate_s")
    powers = (1, 1)
    per = "{rate_o}*{rate_s}"
    cause = (
        "Anisoinertia: where the inertias about spin and input axis differ, turning about both other axes gives a "
        "torque about the output axis. It is a product of both rates."
    )
    cause_zh = "惯量不等：自转轴与输入轴惯量不同时，绕另外两轴同时转动产生绕输出轴的力矩。其大小为两角速率之积。"
    reference = "HIT 2012 (2), term k_os; IEEE 517-1974, anisoinertia"
    aliases = ("cross_axis_o", "cross_axis_s")
    separating_test = "turn about an axis between output and spin axis, at both signs of the tilt and two rates"
    separating_test_zh = "绕输出轴与自转轴之间的倾斜轴旋转，倾斜取正负两种，角速率取两档"
