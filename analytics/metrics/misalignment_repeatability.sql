-- id:        misalignment_repeatability
-- en:        Input-axis misalignment repeatability
-- zh:        输入轴失准角重复性
-- unit:      arcmin
-- better:    lower
-- grain:     unit, signal, run (or all runs of the unit, then no run is named)
-- parameters: misalignments, mean_arcmin, remark
-- source:    JJF 2014-2022 7.2.12 (26)
-- needs:     the misalignment in four positions, Q >= 7 times
-- limits:    chi_square
-- equation:  gamma_mr = sqrt(sum((gamma_i - mean(gamma))^2)/(Q - 1))
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- of:        step_means where regexp_matches(position, '^[Oo][XxYy]_')
with counted as (
  select *, count(*) over (partition by unit, signal, run, warmth) as in_run,
    bool_or(coalesce(starts_with("procedure", 'misalignment_repeat'), false)) over (partition by unit, signal, run)
      as is_test
  from internal.misalignments where positions = 4
  qualify count(distinct warmth) over (partition by unit, signal, run) <= 1
), scoped as (
  select *, run as scope from counted where is_test or in_run > 1
  union all
  select *, null as scope from counted
), collected as (
  select unit, signal, scope,
    coalesce(list(arcmin order by t_from_ns, run, repeat) filter (lack is null), []) as gammas,
    stations_remark(list(station) filter (lack is null)) as stations,
    list(distinct run order by run) as runs,
    flatten(list(steps order by run, t_from_ns, repeat)) as steps,
    min('run ' || run || ': ' || lack) as lack
  from scoped group by unit, signal, scope
  having scope is not null or count(distinct run) > 1
)
select
  unit, signal, scope as run,
  case when len(gammas) >= 7
    then sqrt(list_sum([(g - list_avg(gammas)) ** 2 for g in gammas]) / (len(gammas) - 1)) end as value,
  null::double as standard_uncertainty,
  (len(gammas) - 1)::double as freedom,
  len(gammas) as n,
  {misalignments: len(gammas), mean_arcmin: list_avg(gammas), remark: stations} as parameters,
  runs, steps,
  case when len(gammas) < 7 then
    len(gammas) || ' misalignments measured, the clause asks for 7 or more' || coalesce('; ' || lack, '') end as reason
from collected
