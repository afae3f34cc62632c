-- id:        bias
-- en:        Bias
-- zh:        零偏
-- unit:      deg/h
-- better:    neither
-- grain:     unit, signal, run, step
-- source:    GJB 2426A-2004 5.12.1 (19); JJF 2014-2022 7.2.13 (27)(28)
-- needs:     a static step (procedure static_bias or bias_repeatability), at least one hour long
-- limits:    t
-- equation:  B0 = mean(F)/K
-- The Earth's rate is removed where the position says how it enters (JJF 2014 7.2.13 stands the IRA vertical); both the
-- raw and the corrected value are reported.
with corrected as (
  select *, unnest(case when earth_deg_per_h is null then ['none'] else ['none', 'removed'] end) as earth_rate
  from bias_steps
)
select
  unit, signal, run,
  case when lack is null then
    mean_deg_per_h - case when earth_rate = 'removed' then earth_deg_per_h else 0 end end as value,
  u_deg_per_h as standard_uncertainty,
  freedom,
  n,
  {
    earth_rate: earth_rate, scale_factor: scale_source, position: position, repeat: repeat,
    duration_s: round(duration_s), n_effective: round(n_effective, 1)
  } as parameters,
  [run] as runs,
  ["index"] as steps,
  lack as reason
from corrected
