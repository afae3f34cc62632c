-- id:        bias_acceleration_sensitivity
-- en:        Bias acceleration sensitivity
-- zh:        零偏加速度灵敏度
-- unit:      deg/h/g
-- better:    nearer_zero
-- grain:     unit, signal, run, axis, temperature
-- parameters: axis, earth_rate, earth_rate_in_it, repeat, temperature_command, remark, scale_factor, earth_rate_unknown
-- parameters: axis_of_largest
-- source:    JJF 2014-2022 7.2.17
-- needs:     procedure bias_acceleration_sensitivity: static steps with X, Y and Z up and down
-- limits:    given
-- equation:  (mean(+1 g) - mean(-1 g))/(2 g); of the unit the largest in magnitude
-- influence: rate: per_ppm(raw_difference)
-- influence: voltage: per_ppm_of_voltage(raw_difference, volt)
-- influence: levelling: earth_rate_per_arcsec() * sqrt(0.5)
-- influence: heading: if(earth_pointing(parameters->>'$.axis' || '_up', signal) = 'vertical', 0, earth_rate_per_arcsec() * cos(radians(latitude_deg)) * sqrt(0.5))
-- python:    analytics.methods.largest_magnitude:largest_magnitudes
-- of:        internal.still_steps where phase is null and ("procedure" is null or regexp_matches("procedure", '^bias_acceleration|零偏加速度'))
with shown as (
  select *, axis as shown from internal.bias_flips
  where earth_rate = 'none' or not coalesce(list_contains(level, axis), false)
  union all
  select *, 'largest' from internal.bias_flips
), counted as (
  select *, list_filter(['X', 'Y', 'Z'], lambda each: not list_contains(axes, each)) as absent from shown
)
-- An error of K acts on the differences before the Earth's rate is removed from them.
select unit, signal, run, half as difference, max(abs(raw)) over (tested
    order by axis rows between unbounded preceding and unbounded following) as raw_difference, u, freedom, true as is_signed,
  {run: run, unit: unit, signal: signal, "procedure": "procedure", repeat: repeat,
    warmth: warmth, shown: shown, earth_rate: earth_rate} as test,
  {axis_of_largest: axis} as of_largest,
  case when shown = 'largest' then (sum(n) over tested)::bigint else n end as n,
  case when shown = 'largest' then list_sort(flatten(list(steps) over (tested
    order by axis rows between unbounded preceding and unbounded following))) else steps end as steps,
  case when shown = 'largest' and len(absent) > 0 and not list_contains(axes, 'IRA') then
    'no flip of axis ' || array_to_string(absent, ', ') || ': the clause asks for X, Y and Z' else lack end as reason,
  {
    axis: shown, earth_rate: earth_rate, earth_rate_in_it: max(earth_rate_in_it) over tested, repeat: repeat,
    temperature_command: temperature_command, scale_factor: scale_source,
    remark: nullif(array_to_string(list_sort(list_distinct(list(remark) over tested)), '; '), ''),
    earth_rate_unknown: case when shown = 'largest' and earth_rate = 'removed' then level end
  } as parameters
from counted
window tested as (partition by unit, signal, run, "procedure", repeat, warmth, shown, earth_rate)
order by test, axis
