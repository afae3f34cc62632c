"""Error while the rate changes: finite bandwidth, delay, or true sensitivity to angular acceleration."""

from analytics.loop.effects.monomial import Monomial


class AngularAcceleration(Monomial):
    """Error in proportion to the table's angular acceleration."""

    name = "angular_acceleration"
    en = "angular acceleration (bandwidth, delay)"
    zh = "角加速度（带宽、延时）"
    needs = ("table_acceleration",)
    powers = (1,)
    per = "{table_acceleration}"
    cause = (
        "A gyro of finite bandwidth is behind the rate by a fixed time, so that while the rate changes it reads less "
        "by time times acceleration. A float with inertia about its output axis reacts to acceleration itself."
    )
    cause_zh = (
        "带宽有限的陀螺落后固定时间，角速率变化时读数相差该时间与角加速度之积。带转动惯量的浮子也直接敏感角加速度。"
    )
    reference = (
        "IEEE 517-1974, output-axis angular acceleration; IEEE 952-2020, frequency response; JJF 2014-2022, bandwidth"
    )
    aliases = ("rate_time_offset", "rate_clock_rate")
    separating_test = "sinusoidal rate at several frequencies with one clock for gyro and table"
    separating_test_zh = "陀螺与转台使用同一时钟，在多个频率做正弦角速率试验"
