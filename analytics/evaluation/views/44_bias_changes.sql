-- How the bias has changed from before a shock or vibration to after it: a row for each axis of a test and temperature,
-- deg/h. Which of the two it was (`cause`) is known by the name of the procedure, else of the step.
create or replace view internal.bias_changes as
with phased as (
  select *,
    case when regexp_matches(concat_ws(' ', "procedure", step), 'shock|冲击') then 'shock' else 'vibration' end as cause,
    coalesce(upper(axis), nullif(regexp_extract(position, '^([XYZ])(_|$)', 1), ''), 'unnamed') as along
  from internal.classed_still_steps
  where lower(phase) in ('before', 'after')
    and not regexp_matches(coalesce("procedure", ''), '^scale_factor')
    and regexp_matches(concat_ws(' ', "procedure", step), 'shock|冲击|vibration|振动')
), side as (
  select cause, run, unit, signal, "procedure", repeat, warmth, along, lower(phase) as phase,
    round(avg(temperature_command), 1) as temperature_command,
    bool_and(deg_per_h is not null) as is_scaled, min(n) as least_n, any_value(unit_of_measure) as unit_of_measure,
    any_value(scale_source) as scale_source,
    avg(mean_deg_per_h order by "index") as mean,
    sqrt(sum(u_deg_per_h ** 2 order by "index")) / count(*) as u,
    sum(u_deg_per_h ** 2 order by "index") ** 2
      / nullif(sum(u_deg_per_h ** 4 / greatest(freedom, 1) order by "index"), 0) as freedom,
    min(temperature) as coldest, max(temperature) as warmest,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from phased
  group by all
), axis as (
  select cause, run, unit, signal, "procedure", repeat, warmth, along as axis,
    round(avg(temperature_command), 1) as temperature_command,
    max(mean) filter (phase = 'after') - max(mean) filter (phase = 'before') as change,
    sqrt(sum(u ** 2 order by phase)) as u,
    sum(u ** 2 order by phase) ** 2 / nullif(sum(u ** 4 / greatest(freedom, 1) order by phase), 0) as freedom,
    sum(n)::bigint as n, list_sort(flatten(list(steps order by phase))) as steps,
    any_value(scale_source) as scale_source,
    temperatures_remark(min(coldest), max(warmest)) as remark,
    case
      when not bool_and(is_scaled) then no_scale_factor(any_value(unit_of_measure))
      when min(least_n) = 0 then 'axis ' || along || ': no sample in the evaluated part of a step'
      when count(*) < 2 then 'axis ' || along || ': measured only ' || any_value(phase) || ' the ' || cause
        || ', the clause asks for before and after'
    end as lack
  from side
  group by cause, run, unit, signal, "procedure", repeat, warmth, along
)
select *,
  list(axis) over (partition by cause, run, unit, signal, "procedure", repeat, warmth
    order by axis rows between unbounded preceding and unbounded following) as axes
from axis;

-- Of each test the change along every axis, and the differences of which the largest is taken (`largest_magnitudes`).
create or replace macro bias_axis_changes(cause_of) as table
with changes as (
  select *, list_filter(['X', 'Y', 'Z'], lambda each: not list_contains(axes, each)) as absent,
    unnest([axis, 'largest']) as shown
  from internal.bias_changes where cause = cause_of
)
select unit, signal, run, axis, change as difference, u, freedom, false as is_signed,
  {run: run, unit: unit, signal: signal, "procedure": "procedure", repeat: repeat,
    warmth: warmth, shown: shown} as test,
  {axis_of_largest: axis} as of_largest,
  case when shown = 'largest' then (sum(n) over tested)::bigint else n end as n,
  case when shown = 'largest' then list_sort(flatten(list(steps) over (tested
    order by axis rows between unbounded preceding and unbounded following))) else steps end as steps,
  case when shown = 'largest' and len(absent) > 0 then
    'axis ' || array_to_string(absent, ', ') || ' was not tested: the clause asks for X, Y and Z'
    else lack end as reason,
  {axis: shown, repeat: repeat, temperature_command: temperature_command, scale_factor: scale_source, remark: remark}
    as parameters
from changes
window tested as (partition by unit, signal, run, "procedure", repeat, warmth, shown);
