-- id:        misalignment
-- en:        Input-axis misalignment
-- zh:        输入轴失准角
-- unit:      arcmin
-- better:    lower
-- grain:     unit, signal, run, positions, repeat, temperature
-- parameters: procedure, repeat, temperature_command, positions, rate_deg_per_s, towards_x_arcmin, towards_y_arcmin, arcsec, scale_factor
-- source:    GJB 2426A-2004 5.15 (47)-(49); JJF 2014-2022 7.2.11 (19)-(25)
-- needs:     both directions of a rate with ox up and oy up; against the fixture's error also turned 180 deg about IRA
-- limits:    given
-- equation:  2 positions: asin(hypot(delta_1, delta_2)); 4: hypot((delta_1 - delta_2)/2, (delta_3 - delta_4)/2)
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: mounting: if((parameters->>'$.positions')::int = 2, 1 / 60, 0)
-- influence: angle: sqrt(0.5) / 60
-- of:        step_means where regexp_matches(position, '^[Oo][XxYy]_')
-- The delta of GJB and JJF 2014 are the same, (F+ - F-)/(2 K Omega), and so is what four positions give. Limits: value
-- -+ t u where it is beyond 4 u; nearer to 0 a hypotenuse is too large by nature, and the 95 % radius of two normal
-- errors is taken, 2.45 u.
with halved as (
  select *,
    case when arcmin > 4 * u_radius_arcmin then student_quantile(0.05, freedom) * u_arcmin
      else sqrt(-2 * ln(0.05)) * u_radius_arcmin * student_quantile(0.05, freedom) / 1.959964 end as half
  from internal.misalignments
)
select
  unit, signal, run,
  case when lack is null then arcmin end as value,
  case when half is not null then greatest(0, arcmin - half) end as lo,
  arcmin + half as hi,
  u_arcmin as standard_uncertainty,
  freedom,
  n,
  {
    "procedure": "procedure", repeat: repeat, temperature_command: temperature_command, positions: positions, rate_deg_per_s: rate,
    towards_x_arcmin: of_x * 10800 / pi(), towards_y_arcmin: of_y * 10800 / pi(), arcsec: arcmin * 60,
    scale_factor: scale_source
  } as parameters,
  [run] as runs, steps,
  case positions when 2 then 'GJB2426A' end as standard,
  case positions when 2 then '5.15 (47)-(49)' end as clause,
  lack as reason
from halved
