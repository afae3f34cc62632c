-- Bias against temperature as a difference from room temperature: a row for each step of a test at several
-- temperatures, grouped by where the unit pointed (`lack` says why a group gives none). A curve that was measured
-- again (`again`) is a group of its own. Room temperature is the step that says so, else the one set nearest to 20
-- degC (of two that are as near, the one measured first), at most 10 degC from it; points nearer to it than 1 degC are
-- no points, their quotient would be noise.
-- Steps that wait for the chamber, by their name, are no points where another one measures at the same commanded
-- temperature.
create or replace macro is_waiting_step(step) as
  coalesce(regexp_matches(lower(step), '^(soak|ramp|transition|wait|保温|等待)'), false);

create or replace view internal.bias_temperature_points as
with measuring as (
  select *, is_waiting_step(step)
    and temperature_command is not null and bool_or(not is_waiting_step(step))
      over (partition by run, unit, signal, "procedure", temperature_command) as waits
  from internal.still_steps where phase is null and not turns
), placed as (
  select *,
    -- what was set tells the room: a unit warms itself above it
    coalesce(temperature_command, temperature) as set_to,
    abs(coalesce(temperature_command, temperature) - 20) as from_20,
    count(distinct coalesce(temperature_command, 1e9)) over test as temperatures,
    case when bool_and(repeat is not null) over test then repeat end as again
  from measuring where not waits
  window test as (partition by run, unit, signal, "procedure")
), test as (
  select *,
    bool_or(room) over curve as says_room,
    min(from_20) filter (n > 0) over curve as nearest,
    case when bool_or(room) over curve then room
      else coalesce(set_to = arg_min(set_to, (from_20, "index")) filter (n > 0) over curve and from_20 <= 10, false)
      end as is_room
  from placed
  where regexp_matches("procedure", '^bias_temperature|零偏温度') or temperatures > 1
    and not regexp_matches(coalesce("procedure", ''),
      '^(scale_factor|attitude_unit|misalignment|bias_(shock|vibration))')
  window curve as (partition by run, unit, signal, "procedure", position, again)
), room as (                            -- measured before and after the others, it is the mean of both
  select run, unit, signal, "procedure", position, again,
    avg(mean_deg_per_h order by "index") as mean, avg(temperature order by "index") as temperature,
    sqrt(sum(u_deg_per_h ** 2 order by "index")) / count(*) as u,
    sum(u_deg_per_h ** 2 order by "index") ** 2
      / nullif(sum(u_deg_per_h ** 4 / greatest(freedom, 1) order by "index"), 0) as freedom
  from test where is_room and n > 0
  group by all
), point as (
  select t.*, r.mean as room_mean, r.temperature as room_temperature, r.u as room_u, r.freedom as room_freedom,
    not t.is_room and t.n > 0 and abs(t.temperature - r.temperature) >= 1 as is_point
  from test t left join room r
    on r.run = t.run and r.unit = t.unit and r.signal = t.signal and r."procedure" is not distinct from t."procedure"
    and r.position is not distinct from t.position and r.again is not distinct from t.again
), matched as (                         -- one reading, to the digit, at several temperatures is that of a frozen thermometer
  select *,
    min(asked) over alike as asked_least, max(asked) over alike as asked_most,
    coalesce(max(asked) over alike - min(asked) over alike > 5, false) as is_frozen
  from (select *, coalesce(temperature_command, chamber_temperature) as asked from point)
  window alike as (partition by run, unit, signal, "procedure", position, again, round(temperature, 6))
), counted as (
  select *,
    any_value({reading: temperature, least: asked_least, most: asked_most}) filter (is_frozen) over curve as frozen,
    count(*) filter (n > 0) over curve as known,
    count(*) filter (is_point) over curve as points,
    (sum(n) over curve)::bigint as all_n,
    list("index") over (curve order by "index" rows between unbounded preceding and unbounded following) as all_steps,
    bool_and(deg_per_h is not null) over curve as is_scaled,
    max(temperature_moved) over curve as moved,
    nullif(count(*) filter (temperature_moved > 2) over curve, 0) as ramps
  from matched
  window curve as (partition by run, unit, signal, "procedure", position, again)
), judged as (
  select *,
    case
      when known = 0 then 'no sample in any of its steps'
      when not is_scaled then no_scale_factor(unit_of_measure)
      when room_mean is null then
        'the room-temperature point is missing: none of ' || known || ' steps is marked room, and the nearest to 20 '
        || 'degC' || coalesce(' is ' || round(nearest, 1) || ' degC from it, at most 10', ' has no known temperature, 10')
        || ' are allowed'
      when frozen is not null then
        format('the thermometer reads {:.2f} degC at each of several steps of {:.0f} to {:.0f} degC: it is frozen, and the temperature '
          'is not known there', frozen.reading, frozen.least, frozen.most)
      when room_temperature is null then
        'the temperature of the room-temperature step is unknown: record one, or say temperature_command'
      when points = 0 then
        'no other temperature than that of the room was measured: the clauses ask for points over the range of use'
    end as lack
  from counted
)
select unit, signal, run, "procedure", position, again, "index", temperature, temperature_source, room_temperature,
  scale_source, points, all_n, all_steps, lack,
  case when ramps is not null then format('the temperature moved within {} of the steps, by up to {:.1f} degC: the clauses ask '
    'for a steady one (5.12.4.3 b)', ramps, moved) end as remark,
  (mean_deg_per_h - room_mean) / (temperature - room_temperature) as slope,
  sqrt(u_deg_per_h ** 2 + room_u ** 2) / abs(temperature - room_temperature) as u,
  (u_deg_per_h ** 2 + room_u ** 2) ** 2
    / nullif(u_deg_per_h ** 4 / greatest(freedom, 1) + room_u ** 4 / greatest(room_freedom, 1), 0) as freedom
from judged
where lack is not null or is_point;
