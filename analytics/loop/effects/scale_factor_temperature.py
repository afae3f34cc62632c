"""Scale factor that follows temperature."""

from analytics.loop.effects.monomial import Monomial


class ScaleFactorTemperature(Monomial):
    """Input rate times temperature about 25 degC."""

    name = "scale_factor_temperature"
    en = "scale factor over temperature"
    zh = "标度因数温度灵敏度"
    needs = ("input_rate", "temperature")
    powers = (1, 1)
    per = "{input_rate}*{temperature}"
    cause = (
        "Coil area, refractive index and source wavelength change with temperature, some 10 ppm per degC. The error "
        "is a product of rate and temperature."
    )
    cause_zh = "环面积、折射率和光源波长随温度变化，每摄氏度约十个ppm量级。误差为角速率与温度之积。"
    reference = "IEEE 952-2020, scale-factor temperature sensitivity; GJB 2426A-2004; JJF 2014-2022"
    aliases = ("scale_factor_warm_up", "scale_factor_temperature_squared")
    separating_test = "scale factor at three or more soaked temperatures, in rising and falling order"
    separating_test_zh = "在三个以上保温温度点测标度因数，升温与降温顺序各一次"


class ScaleFactorTemperatureSquared(Monomial):
    """Input rate times temperature squared, about 25 degC."""

    name = "scale_factor_temperature_squared"
    en = "scale factor over temperature squared"
    zh = "标度因数温度二次项"
    needs = ("input_rate", "temperature")
    powers = (1, 2)
    per = "{input_rate}*{temperature}^2"
    cause = (
        "Wavelength of the source and gain of the electronics bend over a wide range of temperature. The scale factor "
        "then has a maximum or minimum within the range."
    )
    cause_zh = "宽温范围内光源波长与电路增益呈弯曲变化。标度因数在范围内出现极大或极小值。"
    reference = "IEEE 952-2020, scale-factor temperature sensitivity; GJB 2426A-2004"
    aliases = ("scale_factor_temperature",)
    separating_test = "scale factor at five or more soaked temperatures over the full range"
    separating_test_zh = "全温范围内在五个以上保温温度点测标度因数"
