"""Bias that follows the gyro's temperature as a polynomial about 25 degC."""

from analytics.loop.effects.monomial import Monomial


class Temperature(Monomial):
    """Bias in proportion to temperature."""

    name = "temperature"
    en = "temperature"
    zh = "温度（一次项）"
    needs = ("temperature",)
    powers = (1,)
    per = "{temperature}"
    cause = (
        "Optical source, coil and electronics shift with temperature, and with them the bias. Near room temperature "
        "the shift is a straight line."
    )
    cause_zh = "光源、光纤环和电路参数随温度漂移，零偏随之变化。在常温附近近似为直线。"
    reference = "IEEE 952-2020, bias temperature sensitivity; GJB 2426A-2004 5.12.4; JJF 2014-2022 7.2.16"
    aliases = ("thermal_lag", "chamber_setpoint", "chamber_temperature", "warm_up", "drift_in_run")
    separating_test = "ramp the temperature up and down again within one run, with dwells long enough to soak"
    separating_test_zh = "同一次测试内升温再降温，并在各温度点充分保温"


class TemperatureSquared(Monomial):
    """Bias as the square of temperature about 25 degC."""

    name = "temperature_squared"
    en = "temperature squared"
    zh = "温度二次项"
    needs = ("temperature",)
    powers = (2,)
    per = "{temperature}^2"
    cause = (
        "Over a wide range the bias bends with temperature, because stresses of bonded parts and wavelength shift do "
        "not add up to a straight line. The lowest order of this bend is the square."
    )
    cause_zh = "在宽温范围内，粘接应力和波长漂移使零偏随温度呈弯曲变化。其最低阶为二次项。"
    reference = "IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4"
    aliases = ("temperature_threshold", "temperature_cubed")
    separating_test = "slow ramp and soak over the full range, at five or more temperatures"
    separating_test_zh = "全温范围内缓慢变温，在五个以上温度点保温测量"


class TemperatureCubed(Monomial):
    """Bias as the cube of temperature about 25 degC."""

    name = "temperature_cubed"
    en = "temperature cubed"
    zh = "温度三次项"
    needs = ("temperature",)
    powers = (3,)
    per = "{temperature}^3"
    cause = (
        "At both ends of the range the bias departs from a parabola with opposite signs, as glass transition of "
        "adhesives and source efficiency do. The cube is the lowest order of that kind."
    )
    cause_zh = "在温度范围两端，胶粘剂玻璃化和光源效率使零偏以相反符号偏离抛物线。三次项是其最低阶。"
    reference = "IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4"
    aliases = ("temperature_squared", "temperature_threshold")
    separating_test = "slow ramp and soak at seven or more temperatures up to both ends of the range"
    separating_test_zh = "缓慢变温至范围两端，在七个以上温度点保温测量"
