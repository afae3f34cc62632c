-- id:        bias_temperature_sensitivity
-- en:        Bias temperature sensitivity
-- zh:        零偏温度灵敏度
-- unit:      deg/h/degC
-- better:    lower
-- grain:     unit, signal, run
-- parameters: room_temperature_deg_c, temperature_source, points
-- parameters: position, repeat, scale_factor, temperature_deg_c_of_largest, remark
-- source:    GJB 2426A-2004 5.12.4 (22); JJF 2014-2022 7.2.16 (31)
-- needs:     procedure bias_temperature_sensitivity: static steps at several temperatures, one of them room temperature
-- limits:    given
-- equation:  Bt = max_i abs((B0_i - B0_room)/(T_i - T_room))
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: temperature: value * sqrt(2) / nullif(abs((parameters->>'$.temperature_deg_c_of_largest')::double - (parameters->>'$.room_temperature_deg_c')::double), 0)
-- python:    analytics.methods.largest_magnitude:largest_magnitudes
-- of:        internal.still_steps where temperature_command is not null or regexp_matches("procedure", '^bias_temperature|零偏温度')
-- A maximum has no symmetric error: the limits are those of `largest_magnitudes`, over all points together. Standard
-- uncertainty and freedom are those of the steepest point. The thermometer's own error is not in it.
select unit, signal, run, all_n as n, all_steps as steps, lack as reason, slope as difference, u, freedom,
  false as is_signed, {temperature_deg_c_of_largest: round(temperature, 2)} as of_largest,
  {run: run, unit: unit, signal: signal, "procedure": "procedure", position: position, again: again} as test,
  {
    room_temperature_deg_c: round(room_temperature, 2), temperature_source: temperature_source, points: points,
    position: position, repeat: again, scale_factor: scale_source,
    temperature_deg_c_of_largest: round(temperature, 2), remark: remark
  } as parameters
from internal.bias_temperature_points
order by test, "index"
