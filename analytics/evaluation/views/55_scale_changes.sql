-- How the scale factor has changed from before a shock or vibration to after it, along each axis and as the largest of
-- X, Y and Z. A change is a magnitude: its lower limit is not below 0. The limits of the largest hold for all axes
-- together (Bonferroni). Only scale factors at one temperature are compared (`class_of`); of several in a phase the mean.
create or replace macro remark_on_temperatures(a, b, name_a, name_b) as
  case when abs(a.temperature - b.temperature) > 2 then
    format('{} at {:.1f} degC, {} at {:.1f} degC: what that does is in the value', name_a, a.temperature, name_b,
      b.temperature) end;

create or replace macro scale_changes(source, cause) as table
with forced as (
  select *,
    temperature_in_force(temperature_command, temperature, run, unit, signal, "procedure", repeat, steps[1]) as in_force
  from scale_results(source)
  where standard = 'JJF2014' and lower(phase) in ('before', 'after') and regexp_matches("procedure", cause)
), begun as (
  select *, begins_class(in_force, run, unit, signal, "procedure", repeat) as begins from forced
), phased as (
  select *, upper(coalesce(axis, 'unnamed')) as along,
    {k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, slope_weights: slope_weights, u: u, freedoms: freedoms,
      points: points, temperature: temperature} as line,
    class_of(begins, in_force, run, unit, signal, "procedure", repeat) as warmth
  from begun
), paired as (
  select run, unit, signal, "procedure", repeat, along, k_unit, warmth,
    round(avg(temperature_command), 1) as temperature_command,
    mean_line(list(line order by steps) filter (lower(phase) = 'before')) as before,
    mean_line(list(line order by steps) filter (lower(phase) = 'after')) as after,
    list(lower(phase) || ': ' || lack order by steps) filter (lack is not null) as lacks,
    flatten(list(steps order by steps)) as steps, sum(n)::bigint as n,
    remark_on_ranges(list(remark_on_range)) as ranges
  from phased group by all
), compared as (
  select *, slope_difference(after, before, 1) as difference,
    nullif(concat_ws('; ', remark_on_temperatures(before, after, 'before it', 'after it'), ranges), '') as remark,
    case
      when before is null then 'axis ' || along || ': not measured before it'
      when after is null then 'axis ' || along || ': not measured after it'
      when len(lacks) > 0 then 'axis ' || along || ' ' || array_to_string(lacks, '; ')
    end as lack
  from paired
), each_axis as (
  select run, unit, signal, "procedure", repeat, k_unit, along as axis, warmth, temperature_command, steps, n, lack,
    remark,
    [{size: abs(difference.change), u: difference.u, freedom: difference.freedom, axis: along,
      ppm: abs(difference.change / before.k) * 1e6}] as changes
  from compared
), largest as (
  select run, unit, signal, "procedure", repeat, k_unit, 'largest' as axis, warmth,
    round(avg(temperature_command), 1) as temperature_command,
    string_agg('axis ' || axis || ' ' || remark, '; ' order by axis) as remark,
    flatten(list(steps order by axis)) as steps, sum(n)::bigint as n,
    case
      when count(lack) > 0 then string_agg(lack, '; ' order by axis)
      when not list_has_all(list(axis), ['X', 'Y', 'Z']) then 'axis '
        || array_to_string(list_filter(['X', 'Y', 'Z'], lambda a: not list_contains(list(axis), a)), ', ')
        || ' not measured: the clause asks for X, Y and Z'
    end as lack,
    flatten(list(changes order by axis)) as changes
  from each_axis group by run, unit, signal, "procedure", repeat, k_unit, warmth
), valued as (
  select *, list_sort(changes, 'desc')[1] as worst,
    [student_quantile(0.05 / len(changes), c.freedom) * c.u for c in changes] as half
  from (select * from each_axis union all by name select * from largest)
)
select
  unit, signal, run,
  case when lack is null then worst.size end as value,
  k_unit as unit_of_measure,
  list_max([greatest(0, z[1].size - z[2]) for z in list_zip(changes, half)]) as lo,
  list_max([z[1].size + z[2] for z in list_zip(changes, half)]) as hi,
  worst.u as standard_uncertainty,
  worst.freedom as freedom,
  n,
  {"procedure": "procedure", repeat: repeat, temperature_command: temperature_command, axis: axis,
    axis_of_largest: worst.axis, ppm: worst.ppm, remark: remark} as parameters,
  [run] as runs, list_sort(steps) as steps,
  lack as reason
from valued;
