"""Names of the axes and the standard channels, and the reference points of temperatures."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Axis(NamedTuple):
    """An axis of a gyro: suffix of its channels, and its name."""

    key: str
    en: str
    zh: str


AXES = (Axis("i", "input axis", "输入轴"), Axis("o", "output axis", "输出轴"), Axis("s", "spin axis", "自转轴"))

CHANNEL_NAMES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "input_rate": ("input rate", "输入角速率"),
        **{f"rate_{key}": (f"rate about the {en}", f"{zh}角速率") for key, en, zh in AXES[1:]},
        "table_rate": ("table rate", "转台角速率"),
        "table_angle": ("table angle", "转台角度"),
        "table_acceleration": ("table acceleration", "转台角加速度"),
        **{f"gravity_{key}": (f"gravity along the {en}", f"{zh}重力分量") for key, en, zh in AXES},
        "temperature": ("gyro temperature", "陀螺温度"),
        "case_temperature": ("case temperature", "壳体温度"),
        "chamber_temperature": ("chamber air temperature", "温箱空气温度"),
        "chamber_setpoint": ("chamber set-point", "温箱设定值"),
        "supply_voltage": ("supply voltage", "供电电压"),
        "supply_current": ("supply current", "供电电流"),
        **{f"magnetic_{key}": (f"magnetic field along the {en}", f"{zh}磁场分量") for key, en, zh in AXES},
        "vibration": ("vibration level", "振动量级"),
        "humidity": ("relative humidity", "相对湿度"),
        "time_since_power_on": ("time since power-on", "通电时间"),
        "day": ("calendar time", "日历时间"),
        "position": ("position", "位置"),
    }
)
"""English and Chinese name of each standard channel."""

_ROOM = MappingProxyType({"degC": 25.0, "K": 298.15, "kelvin": 298.15, "degF": 77.0})


def reference_point(unit_of_measure: str) -> float:
    """Reference of a channel in this unit: 25 degC for a temperature, else 0 (also for raw counts).

    >>> reference_point("degC"), reference_point("K"), reference_point("count")
    (25.0, 298.15, 0.0)
    """
    return _ROOM.get(unit_of_measure, 0.0)


def standard_reference(channel: str) -> float:
    """Reference of a channel in its standard unit, as a simulation has it."""
    return _ROOM["degC"] if "temperature" in channel or channel == "chamber_setpoint" else 0.0


def channel_name(channel: str) -> tuple[str, str]:
    """English and Chinese name; a channel that is not standard keeps its name in the record."""
    return CHANNEL_NAMES.get(channel, (channel, channel))
