-- id:        threshold
-- en:        Threshold
-- zh:        阈值
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, method, repeat
-- parameters: method, repeat, scale_factor
-- source:    GJB 2426A-2004 5.10 (14)-(17); JJF 2014-2022 7.2.9 (16)(17)
-- needs:     procedure threshold (rates in both directions and at rest), threshold_indexing_head or threshold_slow_turn
-- limits:    given
-- equation:  the smallest Omega with |(K Omega - F)/(K Omega)| <= 50 % at it and all larger ones; the larger of + and -
-- influence: rate: per_ppm(value)
-- python:    analytics.metrics.threshold:compute
-- of:        internal.threshold_procedures
-- F is the output less that at rest (JJF 2014 7.2.9.2). On the indexing head no position is without input: there the
-- mean of directions that are opposite to each other is the zero.
with small as (
  select *,
    mean * deg_per_h as output, standard_uncertainty * abs(deg_per_h) as u,
    try_cast(regexp_extract(position, '^(-?[0-9.]+) ?deg$', 1) as double) as angle_deg,
    case when angle_deg is not null and coalesce(rate_command, 0) = 0 then 'indexing_head' else 'rate_table' end
      as method,
    case method when 'rate_table' then input_rate * 3600
      else round(cos(radians(angle_deg)), 12) * cos(radians(latitude_deg)) * earth_rate_deg_per_h() end as input
  from rate_steps
  where n > 0 and frequency is null and regexp_matches("procedure", '^threshold|阈值')
    and not regexp_matches("procedure", 'slow_turn') and coalesce(step, '') not in ('rest_before', 'rate', 'rest_after')
    and (rate_command is not null or regexp_matches(position, '^-?[0-9.]+ ?deg$'))
), opposed as (
  select *,
    case method when 'rate_table' then rate_command = 0
      else count(*) filter ((angle_deg + 720) % 360 < 180) over line
        = count(*) filter ((angle_deg + 720) % 360 >= 180) over line end as is_zero
  from small
  window line as (partition by run, unit, signal, repeat, method, round((angle_deg + 720) % 180, 6))
), grouped as (
  select run, unit, signal, repeat, method,
    list_avg(list(output order by "index") filter (is_zero)) as zero,
    sqrt(list_sum(list(u ** 2 order by "index") filter (is_zero))) / count(*) filter (is_zero) as u_zero,
    list({input: input, output: output, u: u, freedom: coalesce(freedom, 1)} order by "index")
      filter (abs(input) > 0) as points,
    min(scale_source) as scale_source, min(unit_of_measure) as unit_of_measure,
    bool_and(deg_per_h is not null) as is_scaled, bool_and(latitude_deg is not null) as is_placed,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from opposed group by all
), turn as (
  select *, abs(input_rate) * duration_s as turned_deg,
    earth_rate_deg_per_h() * cos(radians(latitude_deg)) as level
  from rate_steps
  where n > 0 and rate_command <> 0 and frequency is null and regexp_matches("procedure", '^threshold_slow_turn|慢转')
)
select unit, signal, run, n, steps, {method: method, repeat: repeat, scale_factor: scale_source} as parameters,
  case when method = 'indexing_head' then 'GJB2426A' end as standard,
  case when method = 'indexing_head' then '5.10.4.2 (16)' end as clause,
  case
    when not is_scaled then no_scale_factor(unit_of_measure)
    when method = 'indexing_head' and not is_placed then no_level_rate()
    when zero is null then 'no record of ' || if(method = 'indexing_head', 'opposite directions', 'the table at rest')
      || ': the output less its zero is compared with the line'
  end as reason,
  [{is_forward: p.input > 0, size: abs(p.input), error: abs(p.input - (p.output - zero)),
    u: sqrt(p.u ** 2 + u_zero ** 2), freedom: p.freedom}
    for p in points] as compared
from grouped
union all by name
select unit, signal, run, n, ["index"] as steps,
  {method: 'slow_turn', repeat: repeat, scale_factor: scale_source} as parameters,
  'GJB2426A' as standard, '5.10.4.3 (17)' as clause,
  case
    when deg_per_h is null then no_scale_factor(unit_of_measure)
    when level is null then no_level_rate()
    when turned_deg < 350 then
      'the table turned by ' || format('{:.0f}', turned_deg) || ' deg, the clause asks for one turn (5.10.3.3)'
  end as reason,
  t_from_ns, t_to_ns, deg_per_h, input_rate, level
from turn
order by run, unit, signal, parameters, steps
