"""Bias that follows the supply."""

from analytics.loop.effects.monomial import Monomial, nominal


class SupplyVoltage(Monomial):
    """In proportion to the supply voltage."""

    name = "supply_voltage"
    en = "supply voltage"
    zh = "供电电压"
    needs = ("supply_voltage",)
    powers = (1,)
    per = "{supply_voltage}"
    cause = (
        "References and source current are not perfectly regulated against the supply. Bias moves in proportion to a "
        "small change of voltage."
    )
    cause_zh = "基准与光源电流对电源的抑制有限。电压小幅变化时零偏成比例移动。"
    reference = "IEEE 952-2020, power-supply sensitivity; IEEE 1431-2004"
    aliases = ("supply_current",)
    separating_test = "supply steps up and down at constant temperature and load"
    separating_test_zh = "恒温恒负载下电压上下阶跃"


class SupplyVoltageSquared(Monomial):
    """As the square of the supply voltage about its nominal value."""

    name = "supply_voltage_squared"
    en = "supply voltage squared"
    zh = "供电电压二次项"
    needs = ("supply_voltage",)
    powers = (2,)
    parameters = (nominal("supply_voltage"),)
    per = "{supply_voltage}^2"
    cause = (
        "A regulator that leaves its range acts on one side of the nominal voltage, and heat of the electronics grows "
        "with the square. Both bend the bias over voltage."
    )
    cause_zh = "稳压器在标称电压一侧失去调整能力，电路发热也随电压平方增加。两者均使零偏随电压弯曲。"
    reference = "IEEE 952-2020, power-supply sensitivity"
    aliases = ("supply_voltage", "supply_current")
    separating_test = "five or more supply voltages on both sides of the nominal one"
    separating_test_zh = "标称电压两侧共五个以上电压点"
