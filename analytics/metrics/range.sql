-- id:        range
-- en:        Input range
-- zh:        最大输入角速率
-- unit:      deg/s
-- better:    higher
-- grain:     unit, signal, run, position, temperature, repeat, visit
-- parameters: procedure, repeat, temperature_command, room, position
-- parameters: axis, phase, visit, temperature, nonlinearity_ppm, largest_rate_deg_per_s
-- source:    GJB 2426A-2004 5.9; JJF 2014-2022 7.2.2
-- needs:     rates as of a scale factor, and the product's limit nonlinearity_ppm
-- limits:    given
-- equation:  the largest tested rate up to which every point meets the limit of the nonlinearity
-- influence: rate: per_ppm(value)
-- of:        internal.scale_fits
-- The line is fitted again to the rates up to each one: a rate beyond the range bends the line of all. Its limits are
-- tested rates too: up to the lower one every point lies within the limit with its uncertainty (Bonferroni), at the
-- upper one a point is surely out of it; none where no rate is, then the range was not reached.
with judged as (
  select r.* exclude (points, k), r.k as slope, f.standard, f.nonlinearity_ppm,
    case f.standard when 'GJB2426A'
      then list_max([abs(p.output - (r.rest_before.output + r.rest_after.output) / 2) for p in r.points])
      else abs(r.k) * (list_max(r.x) - list_min(r.x)) end as full_scale,
    student_quantile(0.05 / r.n_points, list_min(r.noise.freedoms)) as wide
  from (select *, pooled_noise(u, freedoms) as noise from line_fits('internal.range_sets')) r
    join scale_results('internal.scale_fits') f using (run, unit, signal, steps)
  where f.standard <> 'JJF1536'
), deviating as (
  select *,
    list_max([abs(r) for r in residuals]) / full_scale * 1e6 <= nonlinearity_ppm as meets,
    list_max([abs(z[1]) + wide * z[2] for z in list_zip(residuals, residual_uncertainties(dx, sxx, noise.u))])
      / full_scale * 1e6 <= nonlinearity_ppm as surely_meets,
    list_max([abs(z[1]) - wide * z[2] for z in list_zip(residuals, residual_uncertainties(dx, sxx, noise.u))])
      / full_scale * 1e6 > nonlinearity_ppm as surely_fails
  from judged
), reached as (
  select run, unit, signal, steps, standard,
    max(rate_up_to) filter (meets) as value,
    max(rate_up_to) filter (surely_meets) as lo,
    list(rate_up_to order by rate_up_to) filter (surely_fails) as failing
  from deviating group by all
), bounded as (
  select f.*, r.value, r.lo, list_filter(r.failing, lambda rate: rate > r.value)[1] as hi,
    coalesce(f.lack, case
      when f.product is null then 'no product is named for the unit, so no limit of its nonlinearity is known'
      when f.nonlinearity_ppm is null then
        'no limit of the nonlinearity: give nonlinearity_ppm of product ' || f.product || ' in a specification'
      when r.value is null then
        format('no rate meets the limit of {:g} ppm of product {}', f.nonlinearity_ppm, f.product)
    end) as missing
  from scale_results('internal.scale_fits') f left join reached r using (run, unit, signal, steps, standard)
  where f.standard <> 'JJF1536' and f.phase is null
)
select
  unit, signal, run,
  case when missing is null then value end as value,
  lo, hi,
  (hi - lo) / sqrt(12) as standard_uncertainty,
  null::double as freedom,
  n,
  struct_insert(words, temperature := round(temperature, 2), nonlinearity_ppm := nonlinearity_ppm,
    largest_rate_deg_per_s := largest_rate) as parameters,
  [run] as runs, steps, standard,
  case standard when 'GJB2426A' then '5.9' else '7.2.2' end as clause,
  missing as reason
from bounded
