"""Bias by the environment: supply, humidity, vibration, magnetic field."""

from analytics.loop.effects.channel_names import AXES, Axis
from analytics.loop.effects.monomial import Monomial, nominal

_FIELD = {
    "i": (
        (
            "Faraday rotation in twisted fibre, or coupling into electric loops, adds a phase proportional to the "
            "field. A field along the input axis acts through the axial sections of the fibre and the leads."
        ),
        "扭转光纤中的法拉第旋光或电回路耦合产生与磁场成正比的相位。沿输入轴时经由光纤轴向分量和引线进入。",
    ),
    "o": (
        (
            "A field in the plane of the coil rotates the polarisation in twisted fibre (Faraday effect), and the "
            "phases of the two beams do not cancel. The bias is proportional to the field along this axis."
        ),
        "环平面内的磁场使扭转光纤中偏振面旋转（法拉第效应），两束光不能抵消。零偏与该轴磁场成正比。",
    ),
    "s": (
        (
            "A field in the plane of the coil rotates the polarisation in twisted fibre (Faraday effect), and a "
            "magnetic torque acts on motors or torquers. The bias is proportional to the field along this axis."
        ),
        "环平面内的磁场使扭转光纤中偏振面旋转（法拉第效应），电机或力矩器也受磁力矩。零偏与该轴磁场成正比。",
    ),
}
"""By axis: the cause in both languages."""


def _magnetic(axis: Axis) -> Monomial:
    cause, cause_zh = _FIELD[axis.key]
    return Monomial(
        name=f"magnetic_{axis.key}",
        en=f"magnetic field, {axis.en}",
        zh=f"{axis.zh}磁场",
        cause=cause,
        cause_zh=cause_zh,
        reference="Bohm, Petermann and Weidel, Optics Letters 7(4), 1982, 180-182; IEEE 952-2020, magnetic sensitivity",
        aliases=tuple(f"magnetic_{other.key}" for other in AXES if other != axis),
        separating_test="field steps of both signs in a coil, one axis at a time, at constant temperature",
        separating_test_zh="恒温下用磁场线圈逐轴施加正负磁场阶跃",
    )


EFFECTS = (
    *(_magnetic(axis) for axis in AXES),
    Monomial(
        name="humidity",
        en="humidity",
        zh="湿度",
        cause="Adhesive and plastic absorb moisture, swell and strain the coil or die, and surface leakage currents "
        "increase. In packages that are not hermetic the bias shifts within hours.",
        cause_zh="胶和塑料吸湿膨胀使光纤环或芯片受力，表面漏电增加。非气密封装的零偏在数小时内移动。",
        reference="IEEE 1431-2004, environmental sensitivities; GJB 2426A-2004, damp heat",
        aliases=("temperature",),
        separating_test="humidity steps at constant temperature",
        separating_test_zh="恒温下湿度阶跃",
    ),
    Monomial(
        name="supply_voltage",
        en="supply voltage",
        zh="供电电压",
        cause="Voltage references and source current are not fully independent of the supply voltage. For small "
        "changes of the voltage the bias changes in proportion.",
        cause_zh="基准与光源电流对电源的抑制有限。电压小幅变化时零偏成比例移动。",
        reference="IEEE 952-2020, power-supply sensitivity; IEEE 1431-2004",
        aliases=("supply_current",),
        separating_test="supply steps up and down at constant temperature and load",
        separating_test_zh="恒温恒负载下电压上下阶跃",
    ),
    Monomial(
        name="supply_voltage_squared",
        en="supply voltage squared",
        zh="供电电压二次项",
        powers={"supply_voltage": 2},
        parameters=(nominal("supply_voltage"),),
        cause="A regulator that leaves its range acts on one side of the nominal voltage, and the dissipation of the "
        "electronics grows with the square. Both make the bias a curved function of the voltage.",
        cause_zh="稳压器在标称电压一侧失去调整能力，电路发热也随电压平方增加。两者均使零偏随电压弯曲。",
        reference="IEEE 952-2020, power-supply sensitivity",
        aliases=("supply_voltage", "supply_current"),
        separating_test="five or more supply voltages on both sides of the nominal voltage",
        separating_test_zh="标称电压两侧共五个以上电压点",
    ),
    Monomial(
        name="vibration",
        en="vibration level",
        zh="振动量级（一次项）",
        cause="Frictional contacts and loose parts shift under vibration, roughly in proportion to its level. The "
        "bias follows the level, not the direction.",
        cause_zh="摩擦接触面与松动件在振动下移动，大致与量级成正比。零偏随量级变化而与方向无关。",
        reference="IEEE 1431-2004, vibration sensitivity; JJF 2014-2022, vibration",
        aliases=("vibration_squared",),
        separating_test="four or more levels of the same random vibration, with the first level repeated at the end",
        separating_test_zh="同一随机振动谱取四个以上量级，最后重复第一量级",
    ),
    Monomial(
        name="vibration_squared",
        en="vibration rectification",
        zh="振动整流误差",
        powers={"vibration": 2},
        cause="Compliance and demodulation multiply the vibration by itself, which leaves a constant component. The "
        "bias is proportional to the mean-square acceleration.",
        cause_zh="柔度和解调使振动自身相乘，留下直流分量。零偏与加速度均方值成正比。",
        reference="IEEE 1431-2004, vibration rectification; IEEE 517-1974",
        aliases=("vibration",),
        separating_test="four or more levels of the same random vibration, with the first level repeated at the end",
        separating_test_zh="同一随机振动谱取四个以上量级，最后重复第一量级",
    ),
)
