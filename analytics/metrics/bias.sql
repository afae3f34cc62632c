-- id:        bias
-- en:        Bias
-- zh:        零偏
-- unit:      deg/h
-- better:    neither
-- grain:     unit, signal, run, step
-- parameters: earth_rate, scale_factor, position, repeat, duration_s, whole_seconds, n_effective, remark
-- source:    GJB 2426A-2004 5.12.1 (19); JJF 2014-2022 7.2.13 (27)(28)
-- needs:     a static step (procedure static_bias or bias_repeatability), one hour long as a rule
-- limits:    t
-- equation:  B0 = mean(F)/K
-- influence: rate: per_ppm(raw_deg_per_h)
-- influence: voltage: per_ppm_of_voltage(raw_deg_per_h, volt)
-- influence: voltage_offset: coalesce(abs(deg_per_h) / volt, 0)
-- influence: levelling: levelling_deg_per_h(parameters->>'$.position', latitude_deg, body_axis)
-- influence: heading: heading_deg_per_h(parameters->>'$.position', latitude_deg, body_axis)
-- influence: latitude: if(parameters->>'$.earth_rate' = 'removed', latitude_deg_per_h(parameters->>'$.position', latitude_deg, body_axis), 0)
-- of:        internal.still_steps where not turns
-- An error of K acts on F/K as a whole, also where the Earth's rate is removed from it afterwards.
-- The Earth's rate is removed where the position says how it enters; both the raw and the corrected value are reported.
-- The interval is value -+ t(freedom) u with u = sd/sqrt(n_effective): where flicker or random walk leaves few degrees of
-- freedom, t is larger than 1.96 and the interval wider than n_effective alone suggests.
with corrected as (
  select *, unnest(case when is_attitude_known or lacks_body_axis then ['none', 'removed'] else ['none'] end) as earth_rate
  from internal.bias_steps
), judged as (
  select *,
    -- GJB lays the IRA east-west, JJF stands it upright; a bias measured with it north is of neither
    coalesce(regexp_matches(position, '^IRA_(east|west|east_west)$'), false) as is_level_east,
    coalesce(regexp_matches(position, '^IRA_(north|south)$'), false) as is_level_north,
    is_attitude_known and side_in(position) is not null as is_upright,
    coalesce(lack, case when earth_rate = 'removed' then
      case when lacks_body_axis then no_body_axis() when earth_deg_per_h is null then no_latitude() end end) as missing
  from corrected
)
select
  unit, signal, run,
  case when missing is null then
    mean_deg_per_h - case when earth_rate = 'removed' then earth_deg_per_h else 0 end end as value,
  u_deg_per_h as standard_uncertainty,
  freedom,
  n,
  {
    earth_rate: earth_rate, scale_factor: scale_source, position: position, repeat: repeat,
    duration_s: round(duration_s), whole_seconds: case when whole_seconds < duration_s then whole_seconds end,
    n_effective: round(n_effective, 1), remark: nullif(concat_ws('; ', remark, case when is_level_north then
      'the input axis lies north-south: GJB 2426A lays it east-west, JJF 2014 stands it upright'
      when not is_level_east and not is_upright and position is null then
      'no position says how the input axis lies: it is not known how much of the Earth''s rate is in it' end), '')
  } as parameters,
  [run] as runs,
  ["index"] as steps,
  case when is_level_east then 'GJB2426A' when is_upright then 'JJF2014' when is_level_north then 'informative' end
    as standard,
  case when is_level_east then '5.12.1 (19)' when is_upright then '7.2.13 (27)(28)'
    when is_level_north then 'mean of a static step' end as clause,
  missing as reason,
  deg_per_h, mean_deg_per_h as raw_deg_per_h
from judged
