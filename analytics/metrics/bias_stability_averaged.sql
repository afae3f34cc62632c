-- id:        bias_stability_averaged
-- en:        Bias stability (standard deviation of averages)
-- zh:        零偏稳定性(平均)
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, step, averaging time
-- parameters: average_s, position, repeat, scale_factor, remark
-- source:    JJF 2014-2022 7.2.14 (29)
-- needs:     a static step (procedure static_bias or bias_repeatability), one hour long as a rule
-- limits:    chi_square
-- equation:  Bs = sqrt(sum((F_i - mean(F))^2)/(N/P - 1))/K, F_i means over P seconds
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: clock: per_ppm(value) / 2
-- python:    analytics.metrics.bias_stability_averaged:compute
-- of:        internal.still_steps where not turns
with step as materialized (select * from internal.bias_steps),
average as (
  select step.*, unnest([1.0, 10.0, 100.0]::double[]) as average_s, unnest([n_1s, n_10s, n_100s]) as averages,
    unnest([sd_1s, sd_10s, sd_100s]) as sd_of, unnest([freedom_1s, freedom_10s, freedom_100s]) as freedom_of
  from step
  union all
  select step.*, own.average_s, own.n, own.sd, own.freedom
  from internal.product_averages own join step
    on own.run = step.run and own.unit = step.unit and own.signal = step.signal and own."index" = step."index"
)
select unit, signal, run,
  case when lack is null then nullif(sd_of * abs(deg_per_h), 0) end as value,
  freedom_of as freedom,
  coalesce(averages, 0) as n,
  to_json({
    average_s: average_s, position: position, repeat: repeat, scale_factor: scale_source, remark: remark
  })::varchar as parameters,
  [run] as runs, ["index"] as steps,
  coalesce(lack, case
    when sd_of is null then coalesce(averages, 0) || ' averages of ' || replace(average_s::varchar, '.0', '')
      || ' s in the record, at least 2 are needed'
    when sd_of = 0 then 'all ' || n || ' samples are alike: the output is frozen, or its resolution too coarse to '
      || 'show noise'
  end) as reason
from average
order by unit, signal, run, "index", average_s
