"""What names of signals say: channels that are known by theirs, such as the temperature of a unit, and axes."""

import re

STANDARD_CHANNELS = (
    *("input_rate", "rate_o", "rate_s", "table_rate", "table_angle", "table_acceleration"),
    *("gravity_i", "gravity_o", "gravity_s"),
    *("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint"),
    *("supply_voltage", "supply_current", "magnetic_i", "magnetic_o", "magnetic_s"),
    *("vibration", "humidity", "time_since_power_on", "day", "position"),
)
"""Channels of other names take part under their own."""
_SENSOR_WORDS = "rate|gyro|gyr|omega|velocity|vel|spin|turn|acc|accel|acceleration|force"
_LETTER_APART = re.compile(r"(?:^|[^a-z0-9])([xyz])(?=[^a-z0-9]|$)")
_LETTER_JOINED = re.compile(
    rf"(?:(?:{_SENSOR_WORDS}|^w|_w)([xyz])(?=[^a-z0-9]|$))|(?:(?:^|[^a-z0-9])([xyz])(?={_SENSOR_WORDS}))"
)


def signal_axis(signal: str) -> str | None:
    """Axis of its device that a signal belongs to: ``x``, ``y`` or ``z``; None where its name does not say.

    >>> [signal_axis(name) for name in ("rate_x", "angularratey", "gyro_z_filtered", "xrate", "rate", "temperature")]
    ['x', 'y', 'z', 'x', None, None]
    >>> [signal_axis(name) for name in ("X陀螺", "Y轴角速率", "角速率Z", "陀螺(X)", "ジャイロY軸", "陀螺输出")]
    ['x', 'y', 'z', 'x', 'y', None]
    """
    name = signal.lower()
    found = {letter for match in _LETTER_APART.finditer(name) for letter in match.groups()}
    found = found or {letter for match in _LETTER_JOINED.finditer(name) for letter in match.groups() if letter}
    return found.pop() if len(found) == 1 else None
