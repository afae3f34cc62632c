"""Errors by the input rate: scale factor, its curvature, temperature dependence and asymmetry, and its range."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Shape, ShapeParameter, positive
from analytics.loop.effects.block_kernels import mean_excess, mean_inside, mean_magnitude, mirrored
from analytics.loop.effects.monomial import Monomial
from stream.batch import FloatArray

_HALF_WIDTHS = (0.001, 0.0014, 0.002, 0.0028, 0.004, 0.0057, 0.008, 0.011, 0.016, 0.023, 0.032)
_WIDE_HALF_WIDTHS = (0.045, 0.064, 0.09, 0.13, 0.18, 0.25, 0.32)  # where every rate is beyond the others
# where the table stays at smaller rates: down to a millionth of the largest
_NEXT_WIDTH, _MOST_NARROW = 2.0**0.5, 20
_BEYOND_SPREAD, _LEAST_OF_LARGEST = 3.0, 1e-6
_LIMITS = (0.2, 0.25, 0.3, 0.35, 0.4, 0.45)

EFFECTS = (
    Monomial(
        name="scale_factor",
        en="scale factor",
        zh="标度因数",
        powers={"input_rate": 1},
        cause="The gyro converts rate into output by a factor that coil area, wavelength and gain determine. If the "
        "factor in use differs from the true one, the error is proportional to the rate.",
        cause_zh="陀螺以由环面积、波长和增益决定的系数把角速率变为输出。该系数与所用值不符时，误差与角速率成正比。",
        reference="IEEE 952-2020, scale factor; GJB 2426A-2004 5.8; JJF 2014-2022 7.2.1",
        aliases=("table_rate",),
        separating_test="rotate at several rates in both directions about the input axis only",
        separating_test_zh="仅绕输入轴以多个角速率正反向旋转",
    ),
    Monomial(
        name="scale_factor_quadratic",
        en="square of the input rate",
        zh="输入角速率二次项",
        powers={"input_rate": 2},
        cause="Demodulation offset and anisoinertia rectify the rate, so that both directions of rotation give an "
        "error of the same sign. The error grows with the square of the rate.",
        cause_zh="解调偏置和惯性不等使角速率产生整流，正反转误差同号。该误差与角速率平方成正比。",
        reference="HIT 2012 (2), term k_II; IEEE 517-1974, anisoinertia",
        aliases=("scale_factor_asymmetry", "rate_product_io", "rate_product_is"),
        separating_test="three or more rates in each direction",
        separating_test_zh="每个方向至少三个角速率",
    ),
    Monomial(
        name="scale_factor_cubic",
        en="cube of the input rate",
        zh="输入角速率三次项",
        powers={"input_rate": 3},
        cause="A closed loop of finite gain and a sinusoidal detector characteristic compress large rates equally in "
        "both directions. The lowest odd order beyond the linear term is the cube.",
        cause_zh="有限环路增益和正弦型检测特性对大角速率产生对称压缩。保持方向的最低阶为三次项。",
        reference="IEEE 952-2020, scale-factor nonlinearity; GJB 2426A-2004 5.8; "
        "Lefevre, The Fiber-Optic Gyroscope, 2014",
        aliases=("saturation", "dead_zone"),
        separating_test="three or more rates in each direction, up to the maximum rate",
        separating_test_zh="每个方向至少三个角速率，直至最大角速率",
    ),
    Monomial(
        name="scale_factor_temperature",
        en="scale factor over temperature",
        zh="标度因数温度灵敏度",
        powers={"input_rate": 1, "temperature": 1},
        cause="Coil area, refractive index and source wavelength change with temperature, by some 10 ppm per degC. "
        "The error is proportional to the product of rate and temperature.",
        cause_zh="环面积、折射率和光源波长随温度变化，每摄氏度约十个ppm量级。误差为角速率与温度之积。",
        reference="IEEE 952-2020, scale-factor temperature sensitivity; GJB 2426A-2004; JJF 2014-2022",
        aliases=("scale_factor_warm_up", "scale_factor_temperature_squared"),
        separating_test="scale factor at three or more soaked temperatures, with rising and with falling temperature",
        separating_test_zh="在三个以上保温温度点测标度因数，升温与降温顺序各一次",
    ),
    Monomial(
        name="scale_factor_temperature_squared",
        en="scale factor over temperature squared",
        zh="标度因数温度二次项",
        powers={"input_rate": 1, "temperature": 2},
        cause="Over a wide range, the wavelength of the source and the gain of the electronics are curved functions "
        "of temperature. The scale factor then has a maximum or minimum within the range.",
        cause_zh="宽温范围内光源波长与电路增益呈弯曲变化。标度因数在范围内出现极大或极小值。",
        reference="IEEE 952-2020, scale-factor temperature sensitivity; GJB 2426A-2004",
        aliases=("scale_factor_temperature",),
        separating_test="scale factor at five or more soaked temperatures over the full range",
        separating_test_zh="全温范围内在五个以上保温温度点测标度因数",
    ),
)


class ScaleFactorAsymmetry(Effect):
    """Error in proportion to the magnitude of the input rate."""

    name, en, zh = "scale_factor_asymmetry", "scale-factor asymmetry", "标度因数不对称"
    needs = ("input_rate",)
    per = "{input_rate}"
    cause = (
        "Modulation and digital-analogue conversion differ slightly between the two polarities of the feedback. The "
        "scale factor then differs between the directions of rotation, and half the difference times |rate| appears "
        "as a bias."
    )
    cause_zh = "反馈两个极性的调制和数模转换略有差异。正反转标度因数因此不同，其半差乘以角速率绝对值表现为零偏。"
    reference = "IEEE 952-2020, scale-factor asymmetry; GJB 2426A-2004 5.8; CN 102680005"
    aliases = ("scale_factor_quadratic",)
    separating_test = "pairs of equal rates in both directions, at three or more rates"
    separating_test_zh = "三档以上角速率，每档正反转成对测量"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return mean_magnitude(run.channels["input_rate"])[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        rate = channels["input_rate"]
        forward, backward = coefficients[0], -coefficients[0]
        return np.where(rate >= 0.0, forward, backward) * rate


class DeadZone(Effect):
    """Error in proportion to the input rate where its magnitude is below `half_width`."""

    name, en, zh = "dead_zone", "dead zone about zero rate", "零速率死区"
    needs = ("input_rate",)
    parameters = (
        ShapeParameter("half_width", "{input_rate}", _HALF_WIDTHS, "half width of the dead zone", "死区半宽"),
    )
    per = "{input_rate}"
    cause = (
        "At small rates backscatter locks the counter-propagating beams together, or electrical crosstalk locks the "
        "loop. Below the threshold the output is zero or too small; above it the error vanishes."
    )
    cause_zh = "角速率很小时，背向散射使两束光锁定，或电串扰使环路锁定。低于该阈值时输出为零或偏小，超过后误差消失。"
    reference = "IEEE 647-2006, lock-in; IEEE 952-2020, dead band; GJB 2426A-2004, threshold; JJF 2014-2022, threshold"
    aliases = ("scale_factor_cubic",)
    separating_test = "fine steps of rate about zero in both directions, below and above the threshold"
    separating_test_zh = "在零速率附近正反向细分角速率，覆盖阈值上下"

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = super().shapes(runs)
        widths = [positive(shape, "half_width") for shape in found]
        rates = np.abs(np.concatenate([run.mean("input_rate") for run in runs])) if found else np.empty(0)
        if not found:
            return found
        smallest = _smallest_turning(runs)
        narrow = [w for n in range(_MOST_NARROW, 0, -1) if (w := widths[0] * _NEXT_WIDTH**-n) > smallest]
        if narrow or ((rates > 0.5 * widths[0]) & (rates < widths[-1])).any():
            return [*({"half_width": float(f"{each:.3g}")} for each in narrow), *found]
        scale = widths[-1] / _HALF_WIDTHS[-1]
        return [{"half_width": float(f"{part * scale:.3g}")} for part in _WIDE_HALF_WIDTHS]

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return mean_inside(run.channels["input_rate"], positive(shape, "half_width"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        rate = channels["input_rate"]
        seen = np.where(np.abs(rate) >= positive(shape, "half_width"), rate, 0.0)
        return coefficients[0] * (rate - seen)


def _smallest_turning(runs: Sequence[RunBlocks]) -> float:
    """The smallest magnitude of the rates at which the table stays, beyond the spread of the readings."""
    channels = [run.channels["input_rate"] for run in runs]
    rate, spread = (np.concatenate(each) for each in ([c.mean for c in channels], [c.spread for c in channels]))
    rate = np.abs(rate)
    turning = rate[rate > np.fmax(_BEYOND_SPREAD * spread, _LEAST_OF_LARGEST * np.nanmax(rate))]
    return float(np.quantile(turning, 0.01)) if turning.size else np.inf


class Saturation(Effect):
    """Error in proportion to the part of the input rate beyond `limit`."""

    name, en, zh = "saturation", "saturation at large rates", "大角速率饱和"
    needs = ("input_rate",)
    parameters = (ShapeParameter("limit", "{input_rate}", _LIMITS, "rate at which it begins", "饱和起点"),)
    per = "{input_rate}"
    cause = (
        "The amplifier, converter or loop reaches its limit and no longer follows the rate, or follows it with less "
        "gain. The error is zero up to that rate and grows in proportion beyond it."
    )
    cause_zh = "放大器、转换器或环路达到极限，不再跟随角速率或增益下降。误差在该角速率以下为零，以上成比例增长。"
    reference = "IEEE 528-2019, input rate limits; IEEE 952-2020; GJB 2426A-2004, maximum input rate"
    aliases = ("scale_factor_cubic",)
    separating_test = "several rates in both directions between half the maximum rate and the maximum rate"
    separating_test_zh = "在最大角速率的一半至全值之间正反向取若干档"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        rate, limit = run.channels["input_rate"], positive(shape, "limit")
        return (mean_excess(rate, limit) - mean_excess(mirrored(rate), limit))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        rate, limit = channels["input_rate"], positive(shape, "limit")
        return coefficients[0] * (rate - np.clip(rate, -limit, limit))
