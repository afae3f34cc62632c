"""Channels that follow a cause and are not causes themselves: they may accompany a finding, never win over a cause."""

from analytics.loop.effects.base import Role
from analytics.loop.effects.monomial import Monomial

EFFECTS = (
    Monomial(
        name="chamber_setpoint",
        en="chamber set-point",
        zh="温箱设定值",
        role=Role.PROXY,
        cause="The set-point is a command and does not act on the gyro; temperatures follow it. If it explains more "
        "than any temperature, a sensor at the relevant place is missing.",
        cause_zh="设定值只是指令，不直接作用于陀螺，温度随其变化。若其解释力强于各温度，则缺少关键位置的传感器。",
        reference="GJB 2426A-2004 5.12.4 (chamber and gyro temperature)",
        aliases=("temperature", "chamber_temperature", "thermal_lag"),
        follows=("temperature", "temperature_rate", "thermal_lag", "temperature_gradient"),
        separating_test="compare during transients, where set-point, air and gyro temperature differ most",
        separating_test_zh="在变温过程中比较，此时设定值、空气与陀螺温度相差最大",
    ),
    Monomial(
        name="chamber_temperature",
        en="chamber air temperature",
        zh="温箱空气温度",
        role=Role.PROXY,
        cause="Air heats the case and the case heats the gyro; the air itself acts only on connectors and cables. Its "
        "temperature leads the temperature that determines the bias.",
        cause_zh="空气加热壳体，壳体再加热陀螺；空气本身只影响接插件和电缆。它超前于决定零偏的温度。",
        reference="GJB 2426A-2004 5.12.4 (chamber and gyro temperature)",
        aliases=("temperature", "chamber_setpoint", "temperature_gradient"),
        follows=("temperature", "temperature_rate", "thermal_lag", "temperature_gradient"),
        separating_test="change the air temperature around cables only, or shield the gyro from the air",
        separating_test_zh="仅改变电缆周围气温，或将陀螺与空气隔离",
    ),
    Monomial(
        name="supply_current",
        en="supply current",
        zh="供电电流",
        role=Role.PROXY,
        cause="The current depends on voltage, temperature and the state of the electronics. It indicates a change "
        "but is rarely the cause of a change of the bias.",
        cause_zh="电流随电压、温度和电路状态而变。它表明有所变化，但很少是零偏变化的原因。",
        reference="IEEE 952-2020, power-supply sensitivity",
        aliases=("supply_voltage", "temperature", "warm_up"),
        follows=("supply_voltage", "temperature", "warm_up"),
        separating_test="load the supply independently of the gyro, at constant voltage and temperature",
        separating_test_zh="恒压恒温下独立于陀螺改变电源负载",
    ),
    Monomial(
        name="table_rate",
        en="table rate",
        zh="转台角速率",
        role=Role.PROXY,
        cause="The table acts on the gyro through the rates about its three axes, which are the channels to analyse. "
        "The table rate itself explains more only through slip rings, motor fields or a wrong orientation in the "
        "record.",
        cause_zh="转台通过陀螺三个轴的角速率起作用，应以这些角速率分析。"
        "仅当滑环、电机磁场或姿态记录有误时其自身更相关。",
        reference="HIT 2012 (3); IEEE 952-2020, rate table tests",
        aliases=("scale_factor", "cross_axis_o", "cross_axis_s"),
        follows=("scale_factor", "cross_axis_o", "cross_axis_s"),
        separating_test="rotate at the same rates with the gyro mounted in another orientation",
        separating_test_zh="以相同角速率旋转，但改变陀螺的安装方位",
    ),
)
