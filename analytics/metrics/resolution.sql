-- id:        resolution
-- en:        Resolution
-- zh:        分辨率
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, repeat
-- parameters: repeat, base_rate_deg_per_h, scale_factor
-- source:    GJB 2426A-2004 5.11 (18); JJF 2014-2022 7.2.10 (18)
-- needs:     procedure resolution: falling increments upon a base rate in both directions
-- limits:    given
-- equation:  the smallest dOmega with |(dFhat - dF)/dFhat| <= 50 % at it and at all larger ones; the larger of + and -
-- influence: rate: per_ppm(value)
-- python:    analytics.metrics.resolution:compute
-- of:        internal.resolution_procedures
-- The base rate of a direction is that of its steps `base`, else its smallest one; measured before and after the
-- increments, it is the mean of both.
with turning as (
  select *, rate_command > 0 as is_forward, mean * deg_per_h as output, standard_uncertainty * abs(deg_per_h) as u,
    case when bool_or(step = 'base') over side then coalesce(step = 'base', false)
      else abs(rate_command) <= min(abs(rate_command)) over side * (1 + 1e-9) end as is_base
  from rate_steps
  where n > 0 and rate_command <> 0 and frequency is null and regexp_matches("procedure", '^resolution|分辨率')
    and coalesce(step, '') <> 'rate'
  window side as (partition by run, unit, signal, repeat, rate_command > 0)
), grouped as (
  select run, unit, signal, repeat, is_forward,
    list_avg(list(output order by "index") filter (is_base)) as base_output,
    list_avg(list(input_rate * 3600 order by "index") filter (is_base)) as base_rate,
    sqrt(list_sum(list(u ** 2 order by "index") filter (is_base))) / count(*) filter (is_base) as u_base,
    coalesce(list({input: input_rate * 3600, output: output, u: u, freedom: coalesce(freedom, 1)} order by "index")
      filter (not is_base), []) as points,
    min(scale_source) as scale_source, min(unit_of_measure) as unit_of_measure, min(product) as product,
    bool_and(deg_per_h is not null) as is_scaled,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from turning group by all
)
select g.run, g.unit, g.signal,
  case when not bool_and(is_scaled) then no_scale_factor(min(unit_of_measure)) end as reason,
  {repeat: g.repeat, base_rate_deg_per_h: min(abs(base_rate)), scale_factor: min(scale_source)} as parameters,
  min(p.expected_threshold_deg_per_h) as expected_threshold, min(abs(base_rate)) as base_rate,
  flatten(list([
    {is_forward: is_forward, size: abs(p.input - base_rate),
      error: abs((p.input - base_rate) - (p.output - base_output)), u: sqrt(p.u ** 2 + u_base ** 2), freedom: p.freedom}
    for p in points if p.input <> base_rate] order by is_forward)) as compared,
  sum(n)::bigint as n, list_sort(flatten(list(steps order by is_forward))) as steps
from grouped g left join internal.run_products p on p.unit = g.unit and p.run = g.run
group by g.run, g.unit, g.signal, g.repeat order by g.run, g.unit, g.signal, g.repeat
