-- id:        bias_repeatability
-- en:        Bias repeatability
-- zh:        零偏重复性
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run (or all runs of the unit, then no run is named), kind
-- parameters: kind, position, earth_rate, power_ons, power_ons_recorded, days, uncertainty_of_means, beyond_uncertainty, remark
-- source:    GJB 2426A-2004 5.12.3 (21); JJF 2014-2022 7.2.15 (30)
-- needs:     static steps of an hour in several power-ons (procedure bias_repeatability, or runs of static_bias)
-- limits:    given
-- equation:  Br = sqrt(sum((B0_i - mean(B0))^2)/(Q - 1)) over Q power-ons
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- python:    analytics.metrics.bias_repeatability:compute
-- of:        internal.still_steps where not turns
-- A run is a test if its procedure is one or it has several power-ons; all runs of a unit together are another test. A run
-- of one power-on is none where there are more: it is in the test of all runs.
with counted as (
  select *,
    count(*) over (partition by unit, signal, position, earth_rate, run) as in_run,
    count(*) over (partition by unit, signal, position, earth_rate) as in_all,
    bool_or(is_repeated) over (partition by unit, signal, position, earth_rate, run) as is_test
  from internal.bias_power_ons
), scoped as (
  select *, run as scope from counted where in_run > 1 or (is_test and in_all = 1)
  union all
  select *, null as scope from counted
), listed as (
  select unit, signal, position, earth_rate, scope as run, min(lack) as lack,
    list({
      bias: bias, u: u, u_white: u_white, freedom: freedom, duration_s: duration_s, counted_by: counted_by,
      day: coalesce(day::varchar, 'run ' || run)
    } order by t_from_ns, run, power_on) as powered,
    bool_and(day is not null) as is_dated,
    stations_remark(list(station)) as stations,
    list(distinct run order by run) as runs,
    flatten(list(steps order by run, t_from_ns, power_on)) as steps
  from scoped
  group by unit, signal, position, earth_rate, scope
  having scope is not null or count(distinct run) > 1
)
select * exclude (powered), [p.bias for p in powered] as biases, [p.u for p in powered] as uncertainties,
  [p.u_white for p in powered] as of_white_noise, [p.freedom for p in powered] as freedoms,
  [p.duration_s for p in powered] as durations, [p.counted_by for p in powered] as counted_by,
  [p.day for p in powered] as days
from listed
order by unit, signal, position, earth_rate, run
