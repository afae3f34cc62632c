-- id:        fitted_zero
-- en:        Fitted zero
-- zh:        拟合零位
-- unit:      deg/h
-- better:    neither
-- grain:     unit, signal, run, position, temperature, repeat, visit
-- parameters: procedure, repeat, temperature_command, room, position, axis, phase, visit, temperature, output
-- parameters: output_unit, remark
-- source:    GJB 2426A-2004 5.8.1 (6); JJF 2014-2022 7.2.1 (5); JJF 1536-2015 7.1 (15)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    t
-- equation:  JJF 2014: F0/K, F0 = mean(F_j) - K mean(Omega_j), the zero with Earth's rate; GJB 2426A, JJF 1536: (F0 - F_r)/K, less the mean F_r of the rests before and after; about an axis that points down, of the other sign where K < 0
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: voltage_offset: if(standard = 'JJF2014', coalesce(abs(value / nullif((parameters->>'$.output')::double, 0)) / volt, 0), 0)
-- influence: levelling: if(standard = 'JJF2014', earth_rate_per_arcsec() * abs(cos(radians(latitude_deg))), 0)
-- python:    analytics.metrics.fitted_zero:compute
-- of:        internal.scale_fits
select unit, signal, run, position, steps, standard,
  case standard when 'GJB2426A' then '5.8.1 (6)' when 'JJF2014' then '7.2.1 (5)' else '7.1 (15)' end as clause,
  n, words, lack as reason, k, zero, rest_zero, points, rests, rest_before, rest_after,
  zero_weights, slope_weights, temperature, output_unit, remark_on_range
from scale_results('internal.scale_fits')
