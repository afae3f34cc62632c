-- id:        scale_factor
-- en:        Scale factor
-- zh:        标度因数
-- unit:      1
-- better:    neither
-- grain:     unit, signal, run, position, temperature, repeat, visit
-- parameters: procedure, repeat, temperature_command, room, position
-- parameters: axis, phase, visit, temperature, rates, largest_rate_deg_per_s, remark
-- source:    GJB 2426A-2004 5.8.1 (1)-(6); JJF 2014-2022 7.2.1 (2)-(5); JJF 1536-2015 7.1 (10)-(15)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    t
-- equation:  K from the least-squares line F_j = K Omega_j + F0 + v_j
-- influence: rate: per_ppm(value)
-- influence: rate_nonuniformity: per_ppm(value) * nonuniform
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- of:        internal.scale_fits
-- The unit of a value is that of the output over deg/s, and 1 where the output is a rate.
-- Subtracting the rests changes F0 and not K: the standards differ only in what they ask for.
-- Where a measurement satisfies none of them, a row of the standard `informative` has the value of the line, and its
-- `remark` says why.
with formed as (
  select * exclude (words), words, case standard when 'JJF1536' then jjf1536_remark end as remark,
    case standard when 'GJB2426A' then '5.8.1 (1)-(6)' when 'JJF2014' then '7.2.1 (2)-(5)' else '7.1 (10)-(15)' end
      as clause
  from scale_results('internal.scale_fits')
), lacking as (
  select run, unit, signal, steps, string_agg(standard || ': ' || lack, '; ' order by standard) as remark
  from formed group by all having bool_and(lack is not null)
), every as (
  select * exclude (jjf1536_remark) from formed
  union all by name
  select f.* exclude (jjf1536_remark), 'informative' as standard, 'least-squares line' as clause, l.remark
  from internal.scale_fits f join lacking l using (run, unit, signal, steps)
  where isfinite(f.k)
)
select unit, signal, run, case when lack is null then k end as value, k_unit as unit_of_measure,
  u_k as standard_uncertainty, freedom_k as freedom, n,
  struct_insert(words, temperature := round(temperature, 2), rates := n_points,
    largest_rate_deg_per_s := largest_rate,
    remark := nullif(concat_ws('; ', remark, remark_on_points, remark_on_drift('the scale factor',
      slope_of_drift(points, slope_weights, rest_before, rest_after) / k * 1e6, u_k / abs(k) * 1e6, rest_before, rest_after,
      output_unit)), '')) as parameters,
  [run] as runs, steps, standard, clause, lack as reason,
  -- of errors that differ from rate to rate, the part of the slope: sqrt(sum((w_j Omega_j)^2))
  sqrt(list_sum([(z[1] * z[2]) ** 2 for z in list_zip(slope_weights, x)])) as nonuniform
from every
