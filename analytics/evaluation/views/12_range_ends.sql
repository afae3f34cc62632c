-- Where an output no longer follows the rate: it falls short of the line through the smaller rates at all larger ones of
-- a direction, by more than a nonlinearity without an edge does. One row for each scale factor that has such rates.
--
-- Each rate of a direction may be the edge. The line is that of the rates up to it, of the same direction (three at
-- least) or of both (two each), with one between a quarter of the edge and the edge: `off` is how far it misses them, or
-- what their noise allows. Of many rates some are edges, and those just beyond an edge are not judged.
create or replace macro range_ends(source) as table
with one as materialized (
  select row_number() over () as number, run, unit, signal, steps, points, list_max([abs(p.command) for p in points]) as largest
  from query_table(source) where side = 'both'
    -- where small rates show no noise, steps of the resolution look like a shortfall
    and not list_bool_or([p.stands_still and abs(p.command) < 0.5 * list_max([abs(q.command) for q in points]) for p in points])
), point as (
  select number, p.command, p.rate, p.output, coalesce(p.u, 0) as u, sign(p.command) as direction, abs(p.command) as size,
    largest
  from (select number, largest, unnest(points) as p from one)
), edged as (
  select number, direction, largest, max(size) as edge
  from point where size >= 0.02 * largest
  group by number, direction, largest, floor(ln(size / largest) / 0.03)
), pair as (
  select e.*, p.command, p.rate, p.output, p.u, p.size, p.direction = e.direction as is_own,
    p.size <= e.edge * 1.001 as is_within
  from edged e join (select * exclude (largest) from point) p using (number)
), within as (
  select *, floor(ln(size) * 100) as rung from (select *, unnest([true, false]) as of_own from pair) where is_within
    and (is_own or not of_own)
), lined as (
  select number, direction, largest, edge, of_own,
    regr_slope(output, rate) as k, regr_intercept(output, rate) as zero, regr_sxx(output, rate) as sxx, max(u) as most_u,
    avg(rate) filter (is_own and size > 0.999 * edge) as edge_rate,
    avg(output) filter (is_own and size > 0.999 * edge) as edge_output
  from within group by all
  having bool_or(size between 0.25 * edge and 0.85 * edge) and if(of_own,
    bool_or(size < 0.4 * edge) and count(distinct rung) > 2,
    count(distinct rung) filter (is_own) > 1 and count(distinct rung) filter (not is_own) > 1)
), missed as (
  select l.*, max(greatest(2 * w.u, abs(w.output - l.zero - l.k * w.rate))) as off
  from lined l join within w using (number, direction, edge, of_own) group by all
), beyond as (
  select m.*, p.command, p.rate, p.output, p.u, 1 - (p.output - m.zero) / (m.k * p.rate) as short,
    p.size > if(max(p.size) over one > 1.04 * edge, 1.04, 1) * edge as is_judged
  from missed m join (select * exclude (largest) from pair) p using (number, direction, edge)
  where p.is_own and not p.is_within and abs(m.k) > 5 * m.off / sqrt(m.sxx)
  window one as (partition by m.number, m.direction, m.edge, m.of_own)
), judged as (
  select number, list(command) filter (short > 0.01) as commands, max(short) as most
  from beyond group by number, direction, edge, of_own
  -- a kink: short by more than a hundredth, and by ten times what the cube of the rate makes of `off`; a cube that the
  -- line misses within the edge by `off` is missed beyond it by 2 to 3 times that
  having bool_and(short between 0.01 and 3
      and short * abs(k * rate) > 10 * off * abs(rate / edge_rate) ** 3 + 5 * u) filter (is_judged)
    -- bent: beyond the edge it grows by less than half of the slope within
    or any_value(edge) >= 0.1 * any_value(largest) and bool_and(short between 0.05 and 3
      and ((output - edge_output) * sign(k) * direction + 7 * greatest(u, most_u)) / abs(rate - edge_rate)
        < 0.5 * (abs(k) - 5 * off / sqrt(sxx))) filter (is_judged)
)
select run, unit, signal, steps, list_sort(list_distinct(flatten(list(commands)))) as commands, max(most) as most
from judged join one using (number) group by number, run, unit, signal, steps;

-- Whether the rates at which the output stands still are the largest of their directions.
create or replace macro still_at_largest(points) as
  list_bool_or([not p.stands_still for p in points]) and not list_bool_or([p.stands_still and list_bool_or(
    [not o.stands_still and o.command * p.command > 0 and abs(o.command) >= abs(p.command) for o in points]) for p in points]);

create or replace macro remark_on_short(commands, most) as
  case when len(commands) > 0 then
    format('the output no longer follows the rate at {} deg/s: it falls up to {:.2g} % short of the line through the smaller '
      'rates, as where it is clipped or saturated, and the value is of all rates', listed(commands), most * 100) end;

-- Of what is made of several scale factors, by the remark on the range of each.
create or replace macro remark_on_ranges(remarks) as
  case when list_count(remarks) > 0 then
    format('at the largest rates of {} of {} scale factors the output no longer follows the rate: their remarks say where',
      list_count(remarks), len(remarks)) end;
