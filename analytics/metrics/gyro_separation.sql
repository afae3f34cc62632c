-- id:        gyro_separation
-- en:        Misalignment of a gyro by error separation
-- zh:        陀螺仪失准角误差分离
-- unit:      arcsec
-- better:    lower
-- grain:     unit, signal, run, angle
-- parameters: angle, scale_factor, steps_at_each, rms
-- source:    HIT 2012 (2)-(9)
-- needs:     procedure gyro_separation: five positions of gyro and fixture, whole turns of the table in both directions
-- limits:    given
-- equation:  V = V0 - k y0 w cos(b) + k x0 w sin(b) - k y1 w + k z2 w sin(a) - k y2 w cos(a), gamma = hypot(y2, z2)
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: angle: sqrt(0.5)
-- python:    analytics.methods.separation:gyro_rows
-- of:        step_means where starts_with(position, 'alpha')
select run, unit, signal, "procedure", "index", position, mean as output, input_rate, deg_per_h,
  coalesce(scale_source, 'unknown') as scale_source, no_scale_factor(unit_of_measure) as no_scale,
  regexp_extract(position, '^alpha(-?[0-9.]+)_beta', 1)::double as alpha,
  regexp_extract(position, '_beta(-?[0-9.]+)$', 1)::double as beta
from rate_steps
where regexp_full_match(position, 'alpha-?[0-9.]+_beta-?[0-9.]+') and n > 0 and input_rate <> 0
order by run, unit, signal, "procedure", "index"
