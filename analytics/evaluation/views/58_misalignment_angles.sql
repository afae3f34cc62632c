-- How far the input axis is off towards each mounting axis: one row for each position in which ox or oy was up, across
-- the table, with both directions. delta = (F+ - F-)/(2 K Omega): erratum, GJB 2426A (47)(48) multiply by K. The
-- table's rates are the measured ones where they were. `turned` tells the positions in which the unit was turned 180
-- deg about the IRA. A direction that was measured several times is the mean of them, with their scatter.
create or replace macro mean_turn(turns) as
  case when turns is not null then list_transform(list_transform([{
      n: len(turns), output: list_avg([e.output for e in turns]), rate: list_avg([e.rate for e in turns]),
      own: list_sum([e.u ** 2 for e in turns]) / len(turns) ** 2,
      own_freedom: list_sum([e.u ** 2 for e in turns]) ** 2
        / nullif(list_sum([e.u ** 4 / greatest(e.freedom, 1) for e in turns]), 0)
    }],
    lambda q_: struct_insert(q_, seen := case when q_.n > 1
      then list_sum([(e.output - q_.output) ** 2 for e in turns]) / (q_.n * (q_.n - 1)) end)),
    lambda q_: {output: q_.output, rate: q_.rate,
      u: case when list_count([e.u for e in turns]) = q_.n then sqrt(greatest(q_.own, coalesce(q_.seen, 0))) end,
      freedom: case when q_.seen > q_.own then q_.n - 1 else coalesce(q_.own_freedom, 1e9) end})[1] end;

create or replace view internal.misalignment_angles as
with forced as (
  select *,
    temperature_in_force(temperature_command, temperature, run, unit, signal, "procedure", repeat, "index") as in_force
  from rate_steps
  where n > 0 and rate_command <> 0 and frequency is null
    and regexp_matches(position, '^[Oo][XxYy]_(up|down|up_turned_180)$')
), begun as (
  select *, begins_class(in_force, run, unit, signal, "procedure", repeat) as begins from forced
), placed as (
  select *, class_of(begins, in_force, run, unit, signal, "procedure", repeat) as warmth,
    lower(regexp_extract(position, '^[Oo]([XxYy])_', 1)) as mounting_axis,
    regexp_matches(position, '_down$|turned_180$') as turned
  from begun
), directed as (
  select run, unit, signal, "procedure", repeat, warmth, mounting_axis, turned,
    round(avg(temperature_command), 1) as temperature_command,
    mean_turn(list({output: mean * deg_per_h / 3600, u: standard_uncertainty * abs(deg_per_h) / 3600, rate: input_rate,
      freedom: freedom} order by "index") filter (rate_command > 0)) as forwards,
    mean_turn(list({output: mean * deg_per_h / 3600, u: standard_uncertainty * abs(deg_per_h) / 3600, rate: input_rate,
      freedom: freedom} order by "index") filter (rate_command < 0)) as backwards,
    min(position) as position, bool_and(deg_per_h is not null) as is_scaled, min(scale_source) as scale_source,
    min(unit_of_measure) as unit_of_measure, max(abs(rate_command)) as rate,
    min(t_from_ns) as t_from_ns, min(station) as station, min(time_zone) as time_zone,
    bool_and(date_known) as date_known,
    sum(n)::bigint as n, list("index" order by "index") as steps
  from placed group by all
)
select * exclude (forwards, backwards),
  (forwards.output - backwards.output) / (forwards.rate - backwards.rate) as delta,
  sqrt(forwards.u ** 2 + backwards.u ** 2) / (forwards.rate - backwards.rate) as u,
  welch_freedom(forwards.u, forwards.freedom, backwards.u, backwards.freedom) as freedom,
  case
    when not is_scaled then no_scale_factor(unit_of_measure)
    when forwards is null or backwards is null then 'position ' || position || ': measured in one direction only'
  end as lack
from directed;

-- The misalignment in two positions (GJB) and in four (JJF 2014), arcmin, as the hypotenuse of two angles. An angle is
-- alpha_m = (delta_1 - delta_2)/2 of a position and its turn: what is the fixture's has the same sign in both. Erratum:
-- GJB (50), the root of the sum of all four squares, cancels nothing; not offered.
create or replace view internal.misalignments as
with paired as (
  select run, unit, signal, "procedure", repeat, warmth, round(avg(temperature_command), 1) as temperature_command,
    min(scale_source) as scale_source, max(rate) as rate,
    max(delta) filter (mounting_axis = 'x' and not turned) as x,
    max(delta) filter (mounting_axis = 'y' and not turned) as y,
    max(delta) filter (mounting_axis = 'x' and turned) as x_turned,
    max(delta) filter (mounting_axis = 'y' and turned) as y_turned,
    {
      x: max({u: u, freedom: freedom}) filter (mounting_axis = 'x' and not turned),
      y: max({u: u, freedom: freedom}) filter (mounting_axis = 'y' and not turned),
      x_turned: max({u: u, freedom: freedom}) filter (mounting_axis = 'x' and turned),
      y_turned: max({u: u, freedom: freedom}) filter (mounting_axis = 'y' and turned)
    } as spread,
    string_agg(lack, '; ' order by mounting_axis, turned) as lack, list(mounting_axis || turned) as placed,
    bool_or(turned) or coalesce(regexp_matches("procedure", '^misalignment_(four|repeat)'), false) as is_four,
    not coalesce(regexp_matches("procedure", '^misalignment_(four|repeat)'), false) as is_two,
    min(t_from_ns) as t_from_ns, min(station) as station, min(time_zone) as time_zone,
    bool_and(date_known) as date_known,
    sum(n)::bigint as n, list_sort(flatten(list(steps order by mounting_axis, turned))) as steps
  from internal.misalignment_angles group by run, unit, signal, "procedure", repeat, warmth
), counted as (
  select *, unnest(list_filter([2, 4], lambda p: (p = 2 and is_two) or (p = 4 and is_four))) as positions from paired
), angled as (
  select *,
    case positions when 2 then x else (x - x_turned) / 2 end as of_x,
    case positions when 2 then y else (y - y_turned) / 2 end as of_y,
    case positions when 2 then spread.x.u else sqrt(spread.x.u ** 2 + spread.x_turned.u ** 2) / 2 end as u_x,
    case positions when 2 then spread.y.u else sqrt(spread.y.u ** 2 + spread.y_turned.u ** 2) / 2 end as u_y,
    case positions when 2 then spread.x.freedom
      else welch_freedom(spread.x.u, spread.x.freedom, spread.x_turned.u, spread.x_turned.freedom) end as freedom_x,
    case positions when 2 then spread.y.freedom
      else welch_freedom(spread.y.u, spread.y.freedom, spread.y_turned.u, spread.y_turned.freedom) end as freedom_y
  from counted
), joined as (
  select *, sqrt(of_x ** 2 + of_y ** 2) as hypotenuse,
    case when of_x is null or of_y is null then 'positions measured: ' || len(list_distinct(placed)) || ', '
      || positions || ' are asked for: ' || case positions when 2 then 'ox up and oy up'
        else 'ox up, oy up, and each turned 180 deg about the IRA' end end as lack_of_positions
  from angled
)
select * exclude (lack, lack_of_positions, spread, placed),
  case positions when 2 then asin(hypotenuse) else hypotenuse end * 10800 / pi() as arcmin,
  sqrt((of_x * u_x) ** 2 + (of_y * u_y) ** 2) / hypotenuse * 10800 / pi() as u_arcmin,
  greatest(u_x, u_y) * 10800 / pi() as u_radius_arcmin,
  welch_freedom(of_x * u_x, freedom_x, of_y * u_y, freedom_y) as freedom,
  coalesce(lack, lack_of_positions) as lack
from joined;
