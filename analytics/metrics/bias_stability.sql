-- id:        bias_stability
-- en:        Bias stability (standard deviation of the samples)
-- zh:        零偏稳定性
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, step
-- parameters: scale_factor, position, repeat, duration_s, whole_seconds, n_effective, remark
-- source:    GJB 2426A-2004 5.12.2 (20)
-- needs:     a static step (procedure static_bias or bias_repeatability), one hour long as a rule
-- limits:    chi_square
-- equation:  Bs = sqrt(sum((F_i - mean(F))^2)/(n - 1))/K
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- of:        internal.still_steps where not turns
-- Of the raw samples, so it rises with the sample rate; over averages it is bias_stability_averaged. Not bias
-- instability, which is the floor of the Allan deviation. The samples correlate: the freedom is less than n - 1. An
-- output that stands still is no perfect one: 0 would pass every limit.
select
  unit, signal, run,
  case when lack is null then nullif(sd * abs(deg_per_h), 0) end as value,
  null::double as standard_uncertainty,
  sd_freedom as freedom,
  n,
  {
    scale_factor: scale_source, position: position, repeat: repeat, duration_s: round(duration_s),
    whole_seconds: case when whole_seconds < duration_s then whole_seconds end, n_effective: round(n_effective, 1), remark: remark
  } as parameters,
  [run] as runs,
  ["index"] as steps,
  coalesce(lack, case
    when sd is null then 'one sample in the step: a standard deviation needs two'
    when sd = 0 then 'all ' || n || ' samples are alike: the output is frozen, or its resolution too coarse to show noise'
  end) as reason
from internal.bias_steps
