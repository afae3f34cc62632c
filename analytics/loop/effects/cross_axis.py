"""Errors by rates about the other axes: misalignment, products of rates as in the model of HIT 2012, acceleration."""

from analytics.loop.effects.channel_names import AXES, Axis
from analytics.loop.effects.monomial import Monomial

_INPUT, _OUTPUT, _SPIN = AXES


def _cross_axis(axis: Axis, other: Axis) -> Monomial:
    return Monomial(
        name=f"cross_axis_{axis.key}",
        en=f"cross-axis rate, {axis.en}",
        zh=f"{axis.zh}交叉耦合",
        powers={f"rate_{axis.key}": 1},
        cause=f"The input axis is misaligned towards the {axis.en} by a small angle. It senses that fraction of the "
        f"rate about the {axis.en}.",
        cause_zh=f"输入轴向{axis.zh}方向有微小倾斜。因此输入轴敏感到{axis.zh}角速率的一部分。",
        reference="HIT 2012 (2)-(9); IEEE 952-2020, input axis misalignment; JJF 2014-2022",
        aliases=(f"cross_axis_{other.key}", "table_rate"),
        separating_test=f"rotate about the {axis.en} at several rates with the input axis horizontal",
        separating_test_zh=f"输入轴水平放置，绕{axis.zh}以多个角速率旋转",
    )


def _product(
    one: Axis, other: Axis, en: str, cause: str, cause_zh: str, reference: str, *aliases: str, rates: int = 1
) -> Monomial:
    channels = ("input_rate" if axis is _INPUT else f"rate_{axis.key}" for axis in (one, other))
    return Monomial(
        name=f"rate_product_{one.key}{other.key}",
        en=en,
        zh=f"{one.zh}与{other.zh}角速率乘积",
        powers=dict.fromkeys(channels, 1),
        cause=cause,
        cause_zh=cause_zh,
        reference=reference,
        aliases=aliases,
        separating_test=f"rotate about an axis between {one.en.removesuffix(' axis')} and {other.en}, with positive "
        "and negative tilt" + (", at two rates" if rates == 2 else ""),
        separating_test_zh=f"绕{one.zh}与{other.zh}之间的倾斜轴旋转，倾斜取正负两种"
        + ("，角速率取两档" if rates == 2 else ""),
    )


EFFECTS = (
    _cross_axis(_OUTPUT, _SPIN),
    _cross_axis(_SPIN, _OUTPUT),
    _product(
        _INPUT,
        _OUTPUT,
        "input rate times output-axis rate",
        "Unequal moments of inertia and the tilt of the float under rate couple the two axes. The torque, and hence "
        "the error, is proportional to the product of both rates.",
        "惯量不等和浮子在角速率下的倾斜使两轴耦合。力矩及误差为两个角速率的乘积。",
        "HIT 2012 (2), term k_Io; IEEE 517-1974, cross coupling",
        "scale_factor_quadratic",
    ),
    _product(
        _INPUT,
        _SPIN,
        "input rate times spin-axis rate",
        "The float is off null in proportion to the input rate, which tilts the input axis towards the spin axis. The "
        "output therefore contains the product of input rate and rate about the spin axis.",
        "输入角速率使浮子偏离零位，输入轴向自转轴偏转。自转轴角速率因此以乘积形式进入输出。",
        "HIT 2012 (2), term k_Is; IEEE 517-1974, cross coupling",
        "scale_factor_quadratic",
    ),
    _product(
        _OUTPUT,
        _SPIN,
        "output-axis rate times spin-axis rate",
        "Anisoinertia: where the moments of inertia about spin and input axis differ, rotation about both other axes "
        "produces a torque about the output axis. The torque is proportional to the product of both rates.",
        "惯量不等：自转轴与输入轴惯量不同时，绕另外两轴同时转动产生绕输出轴的力矩。其大小为两角速率之积。",
        "HIT 2012 (2), term k_os; IEEE 517-1974, anisoinertia",
        "cross_axis_o",
        "cross_axis_s",
        rates=2,
    ),
    Monomial(
        name="angular_acceleration",
        en="angular acceleration (bandwidth, delay)",
        zh="角加速度（带宽、延时）",
        powers={"table_acceleration": 1},
        cause="A gyro of finite bandwidth lags the rate by a fixed time; while the rate changes, its output is in "
        "error by that time times the acceleration. A float with inertia about its output axis also responds to the "
        "acceleration directly.",
        cause_zh="带宽有限的陀螺落后固定时间，角速率变化时读数相差该时间与角加速度之积。"
        "带转动惯量的浮子也直接敏感角加速度。",
        reference="IEEE 517-1974, output-axis angular acceleration; IEEE 952-2020, frequency response; JJF 2014-2022, "
        "bandwidth",
        aliases=("rate_time_offset", "rate_clock_rate"),
        separating_test="sinusoidal rate at several frequencies with one clock for gyro and table",
        separating_test_zh="陀螺与转台使用同一时钟，在多个频率做正弦角速率试验",
    ),
)
