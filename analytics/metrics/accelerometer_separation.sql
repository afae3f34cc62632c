-- id:        accelerometer_separation
-- en:        Misalignment of an accelerometer by error separation
-- zh:        加速度计失准角误差分离
-- unit:      arcsec
-- better:    lower
-- grain:     unit, signal, run, angle
-- parameters: angle, scale_factor, steps_at_each, rms
-- source:    HIT 2012 (10)-(13)
-- needs:     procedure accelerometer_separation: four angles about the input axis
-- limits:    given
-- equation:  y2 = (V(180) - V(0))/2k, z2 = (V(90) - V(270))/2k, gamma = hypot(y2, z2)
-- influence: angle: sqrt(0.5)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- python:    analytics.methods.separation:accelerometer_rows
-- of:        step_means where starts_with(position, 'beta')
-- Beside them what the paper's model lacks: twice_beta = (V(0) + V(180) - V(90) - V(270))/4k, a term in twice the angle.
-- k of an output in V is the nominal scale_factor of the product, which for a unit without a gyro is taken per g.
with gyro as (select distinct run, unit from internal.gyro_steps)
select s.run, s.unit, s.signal, s."procedure", s."index", s.position, s.mean as output,
  s.standard_uncertainty as u, s.freedom, s.unit_of_measure, s.gravity_m_per_s2,
  regexp_extract(s.position, '^beta(-?[0-9.]+)$', 1)::double as beta,
  case when g.unit is null then p.scale_factor end as per_g,
  case when g.unit is null and p.scale_factor is not null then 'nominal of product ' || s.product
    else 'output is an acceleration' end as scale_source
from step_means s
left join gyro g on g.run = s.run and g.unit = s.unit
left join internal.product_scales p on p.unit = s.unit and p.run = s.run and p.unit_of_measure = s.unit_of_measure
where regexp_full_match(s.position, 'beta-?[0-9.]+') and s.n > 0
  and regexp_matches(s.signal, '^acc(el(eration|erometer)?)?(_|$)')
order by s.run, s.unit, s.signal, s."procedure", s."index"
