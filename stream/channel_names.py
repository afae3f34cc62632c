"""Names under which channels beside a signal are known, such as the temperature of a unit."""

STANDARD_CHANNELS = (
    *("input_rate", "rate_o", "rate_s", "table_rate", "table_angle", "table_acceleration"),
    *("gravity_i", "gravity_o", "gravity_s"),
    *("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint"),
    *("supply_voltage", "supply_current", "magnetic_i", "magnetic_o", "magnetic_s"),
    *("vibration", "humidity", "time_since_power_on", "day", "position"),
)
"""Channels of other names take part under their own."""
