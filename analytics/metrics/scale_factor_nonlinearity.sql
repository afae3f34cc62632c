-- id:        scale_factor_nonlinearity
-- en:        Scale-factor nonlinearity
-- zh:        标度因数非线性度
-- unit:      ppm
-- better:    lower
-- grain:     unit, signal, run, position, temperature, repeat, visit
-- parameters: procedure, repeat, temperature_command, room, position
-- parameters: axis, phase, visit, temperature, rate_of_maximum_deg_per_s, largest_rate_deg_per_s, remark
-- source:    GJB 2426A-2004 5.8.2 (7)-(9); JJF 2014-2022 7.2.2 (6)-(8)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    given
-- equation:  K_n = max|(Fhat_j - F_j)/F_max|; JJF 2014: over K |Omega_max+ - Omega_max-|, the full span
-- influence: rate_nonuniformity: if(standard = 'GJB2426A', 1, 0.5)
-- of:        internal.scale_fits
-- A maximum comes out too large where noise rules. Its limits hold for all points at once (Bonferroni): the largest
-- lower and the largest upper limit of any point. Noise that may be one at all rates is taken as one.
with pooled as (
  select *, pooled_noise(u, freedoms) as noise from scale_results('internal.scale_fits') where standard <> 'JJF1536'
), scaled as (
  select *,
    case standard when 'GJB2426A' then list_max([abs(p.output - rest_zero) for p in points])
      else abs(k) * (list_max(x) - list_min(x)) end as full_scale,
    student_quantile(0.05 / n_points, list_min(noise.freedoms)) as wide
  from pooled
), deviating as (
  select *,
    [{size: abs(z[1] / full_scale) * 1e6, u: z[2] / full_scale * 1e6, rate: z[3].command, freedom: z[4]}
      for z in list_zip(residuals, residual_uncertainties(dx, sxx, noise.u), points, noise.freedoms)] as deviations
  from scaled
), drifting as (
  select *,
    drift_at(points, rest_before, rest_after) as drift,
    slope_of_drift(points, slope_weights, rest_before, rest_after) as drift_slope
  from deviating
), bent as (  -- what a line leaves of the drift
  select *,
    list_max([abs(z[1] - list_avg(drift) - drift_slope * z[2]) for z in list_zip(drift, dx)]) / full_scale * 1e6 as drift_ppm
  from drifting
), largest as (
  select *, list_sort(deviations, 'desc')[1] as worst from bent
)
select
  unit, signal, run,
  case when lack is null then worst.size end as value,
  case when worst.u is not null then list_max([greatest(0, d.size - wide * d.u) for d in deviations]) end as lo,
  case when worst.u is not null then list_max([d.size + wide * d.u for d in deviations]) end as hi,
  worst.u as standard_uncertainty,
  worst.freedom as freedom,
  n,
  struct_insert(words, temperature := round(temperature, 2), rate_of_maximum_deg_per_s := worst.rate,
    largest_rate_deg_per_s := largest_rate,
    remark := nullif(concat_ws('; ', remark_on_points, remark_on_drift('the nonlinearity', drift_ppm, worst.u, rest_before,
      rest_after, output_unit)), '')) as parameters,
  [run] as runs, steps, standard,
  case standard when 'GJB2426A' then '5.8.2 (7)-(9)' else '7.2.2 (6)-(8)' end as clause,
  lack as reason
from largest
