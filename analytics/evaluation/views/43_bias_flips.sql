-- How the bias differs between +1 g and -1 g along an axis, half of it, deg/h/g: a row for each axis of a test and
-- commanded temperature, as it
-- was measured and, where the flipped axis is the input axis, without the Earth's rate, which flips with it. Across
-- the input axis the flip leaves it level, and what the Earth's rate adds depends on a heading that no word tells.
-- `earth_rate_in_it` says of a value as measured how much of it the Earth's rate is; without a latitude nobody knows,
-- and nothing says how sure the value is.
create or replace macro temperatures_remark(coldest, warmest) as
  case when warmest - coldest > 2 then
    format('steps from {:.1f} to {:.1f} degC are compared: what that does to the bias is in the value', coldest, warmest) end;

-- The temperature in force at a step of a test: what was commanded, at it or at the last step before that says so; where all
-- commands are one, that one; else what was measured.
create or replace macro temperature_in_force(command, temperature, run, unit, signal, "procedure", repeat, "index") as
  coalesce(command,
    last_value(command ignore nulls) over (partition by run, unit, signal, "procedure", repeat order by "index"
      rows unbounded preceding),
    case when min(command) over (partition by run, unit, signal, "procedure", repeat)
        = max(command) over (partition by run, unit, signal, "procedure", repeat)
      then max(command) over (partition by run, unit, signal, "procedure", repeat) end,
    temperature);

-- Temperatures that are compared as one: sorted, they are less than 5 degC apart from one to the next.
create or replace macro begins_class(in_force, run, unit, signal, "procedure", repeat) as
  coalesce(in_force - lag(in_force) over (partition by run, unit, signal, "procedure", repeat order by in_force) >= 5, false);

create or replace macro class_of(begins, in_force, run, unit, signal, "procedure", repeat) as
  sum(begins::int) over (partition by run, unit, signal, "procedure", repeat order by in_force);

create or replace view internal.classed_still_steps as
with forced as (
  select *,
    temperature_in_force(temperature_command, temperature, run, unit, signal, "procedure", repeat, "index") as in_force
  from internal.still_steps
  where not turns and (lower(phase) in ('before', 'after') or phase is null
    and (regexp_matches("procedure", '^bias_acceleration|零偏加速度')
      or "procedure" is null and regexp_matches(position, '^[XYZ]_(up|down)$')))
), begun as (
  select *, begins_class(in_force, run, unit, signal, "procedure", repeat) as begins from forced
)
select * exclude (begins), class_of(begins, in_force, run, unit, signal, "procedure", repeat) as warmth from begun;

create or replace view internal.bias_flips as
with flip as (
  select *,
    coalesce(upper(axis), axis_in(position),
      case when regexp_matches(position, '^(IRA|vertical)_(up|down)$') then 'IRA' end, 'unnamed') as flipped,
    side_in(position) as g
  from internal.classed_still_steps where phase is null
), side as (
  select run, unit, signal, body_axis, lacks_body_axis, "procedure", repeat, warmth, flipped, g,
    round(avg(temperature_command), 1) as temperature_command,
    count(*) filter (n = 0 or deg_per_h is null) as unknown,
    any_value(unit_of_measure) as unit_of_measure, any_value(scale_source) as scale_source,
    any_value(latitude_deg) as latitude_deg, bool_and(deg_per_h is not null) as is_scaled,
    avg(mean_deg_per_h order by "index") as mean,
    sqrt(sum(u_deg_per_h ** 2 order by "index")) / count(*) as u,
    sum(u_deg_per_h ** 2 order by "index") ** 2
      / nullif(sum(u_deg_per_h ** 4 / greatest(freedom, 1) order by "index"), 0) as freedom,
    min(temperature) as coldest, max(temperature) as warmest,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from flip where g is not null
  group by all
), pair as (
  select run, unit, signal, "procedure", repeat, warmth, flipped as axis,
    round(avg(temperature_command), 1) as temperature_command,
    (max(mean) filter (g = 1) - max(mean) filter (g = -1)) / 2 as half,
    sqrt(sum(u ** 2 order by g)) / 2 as u,
    sum(u ** 2 order by g) ** 2 / nullif(sum(u ** 4 / greatest(freedom, 1) order by g), 0) as freedom,
    sum(n)::bigint as n, list_sort(flatten(list(steps order by g))) as steps,
    any_value(scale_source) as scale_source,
    temperatures_remark(min(coldest), max(warmest)) as remark,
    flipped = 'IRA' or case when lacks_body_axis then null else coalesce(flipped = body_axis, false) end as is_input,
    case when is_input then sin(radians(any_value(latitude_deg))) * earth_rate_deg_per_h() end as earth,
    case
      when not bool_and(is_scaled) then no_scale_factor(any_value(unit_of_measure))
      when sum(unknown) > 0 then 'axis ' || flipped || ': no sample in the evaluated part of a step'
      when count(*) < 2 then 'axis ' || flipped || ': measured only with it '
        || case when max(g) = 1 then 'up' else 'down' end || ', the clause asks for up and down'
    end as lack
  from side
  group by run, unit, signal, body_axis, lacks_body_axis, "procedure", repeat, warmth, flipped
), whole as (
  select *,
    list(axis) over test as axes,
    list(axis) filter (not is_input) over test as level,
    case when coalesce(is_input, true) then coalesce(printf('%.4g', earth), 'up to ' || printf('%.4g', earth_rate_deg_per_h()))
      || ' deg/h/g' end as earth_rate_in_it,
    case when is_input is null then no_body_axis() when is_input and earth is null then no_latitude() end as not_removable
  from pair
  window test as (partition by run, unit, signal, "procedure", repeat, warmth
    order by axis rows between unbounded preceding and unbounded following)
)
select run, unit, signal, "procedure", repeat, warmth, temperature_command,
  nullif(concat_ws('; ', remark, case when not_removable is not null then 'the Earth''s rate is in it, '
    || earth_rate_in_it || ', so that it has no interval: ' || not_removable end), '') as remark,
  axis, axes, level, half, half as raw, case when not_removable is null then u end as u, freedom, n, steps,
  scale_source, lack, 'none' as earth_rate, earth_rate_in_it
from whole
union all
select run, unit, signal, "procedure", repeat, warmth, temperature_command, remark, axis, axes, level,
  half - coalesce(earth, 0), half, u, freedom, n, steps, scale_source,
  coalesce(lack, not_removable), 'removed', null
from whole where len(level) < len(axes) or level is null;
