"""Bias that follows humidity."""

from analytics.loop.effects.monomial import Monomial


class Humidity(Monomial):
    """In proportion to relative humidity."""

    name = "humidity"
    en = "humidity"
    zh = "湿度"
    needs = ("humidity",)
    powers = (1,)
    per = "{humidity}"
    cause = (
        "Adhesive and plastic swell with moisture and strain coil or die, and surfaces leak current. Packages that "
        "are not hermetic move their bias within hours."
    )
    cause_zh = "胶和塑料吸湿膨胀使光纤环或芯片受力，表面漏电增加。非气密封装的零偏在数小时内移动。"
    reference = "IEEE 1431-2004, environmental sensitivities; GJB 2426A-2004, damp heat"
    aliases = ("temperature",)
    separating_test = "humidity steps at constant temperature"
    separating_test_zh = "恒温下湿度阶跃"
