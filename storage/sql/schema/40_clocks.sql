-- The source's clock relative to the recorder's, from the lower envelope of arrival minus source time, since delays are
-- positive. drift_ppm is positive if the source's clock is fast. Pieces begin at leaps of the source's time and at
-- power-ons; they share one slope, each with its own level. Stretches far above the line were delayed and are left out.
create or replace view internal.lake_clock_pieces as
with leap as (
  select k.*, c.unit, c.signal, c.run, c.dt_ns, c.irregular,
    k.t_first_ns - lag(k.t_last_ns) over own - c.dt_ns as step_ns
  from internal.lake_clocks k join internal.lake_channels c using (channel)
  window own as (partition by k.channel order by k.seq_first)
)
select *,
  sum(case when step_ns <= -dt_ns - 1000000
    or step_ns > case when irregular then 10000000000 else dt_ns // 2 + 1000000 end then 1 else 0 end)
    over (partition by channel order by seq_first) as piece
from leap;

create or replace view internal.lake_clock_levels as
with level as (
  select unit, signal, run, channel, piece,
    case when piece > 0 then arg_min(step_ns, seq_first) end as step_ns,
    min(delay_least_ns) as level_ns
  from internal.lake_clock_pieces
  group by unit, signal, run, channel, piece
)
-- a gap in the samples leaves the level of the delays; setting the clock moves it by as much
select *,
  level_ns - lag(level_ns) over (partition by channel order by piece) as rise_ns
from level;

create or replace view clocks as
with point as (
  select unit, signal, run, channel, piece,
    (t_least_ns - min(t_least_ns) over own) / 1e9 as x,
    (delay_least_ns - min(delay_least_ns) over own) / 1e3 as y
  from internal.lake_clock_pieces
  window own as (partition by channel, piece)
), first_line as (
  select *,
    x - avg(x) over own as dx, y - avg(y) over own as dy
  from point window own as (partition by channel, piece)
), first_slope as (
  select unit, signal, run, sum(dx * dy) / nullif(sum(dx * dx), 0) as slope
  from first_line group by unit, signal, run
), residual as (
  select p.*, y - slope * x - median(y - slope * x) over (partition by channel, piece) as r
  from point p join first_slope using (unit, signal, run)
), width as (
  select unit, signal, run, median(abs(r)) as mad from residual group by unit, signal, run
), kept as (
  select r.*, x - avg(x) over own as dx, y - avg(y) over own as dy
  from residual r join width using (unit, signal, run)
  where abs(r.r) <= 6 * mad + 1
  window own as (partition by channel, piece)
), line as (
  select unit, signal, run, sum(dx * dx) as sxx, sum(dx * dy) as sxy, sum(dy * dy) as syy,
    count(*) - count(distinct (channel, piece)) - 1 as freedom
  from kept group by unit, signal, run
), jumps as (
  select unit, signal, run,
    count(*) filter (step_ns < 0) as backward,
    count(*) filter (is_jump) as jumps,
    arg_max(step_ns, abs(step_ns)) filter (is_jump) as largest_jump_ns
  -- as doubles: the sum of two leaps of centuries exceeds 64 bits
  from (select *, abs(rise_ns::double + step_ns) < abs(step_ns) / 2 as is_jump from internal.lake_clock_levels)
  group by unit, signal, run
), stretch as (
  select unit, signal, run,
    min(delay_least_ns) as offset_least_ns,
    max(delay_least_ns) as offset_most_ns,
    sum(backward_inside)::bigint as backward_inside,
    max(backward_most_ns) as backward_most_ns,
    count(*) as stretches,
    sum(messages)::bigint as messages,
    sum(arrival_last_ns - arrival_first_ns) as arrival_ns,
    sum(t_last_ns - t_first_ns) as source_ns
  from internal.lake_clock_pieces group by unit, signal, run
), judged as (
  select *,
    case
      when abs(sxy / nullif(sxx, 0)) > 1e4 or messages > 10 and source_ns > 10 * arrival_ns then
        'arrived ' || case when sxy > 0 then 'slower' else 'faster' end
        || ' than it was sampled: imported, replayed or simulated, not live'
      when coalesce(freedom, 0) < 1 then
        stretches || ' stretches of arrivals, of a minute each; at least 3 between two leaps are needed'
    end as reason
  from stretch left join line using (unit, signal, run) left join jumps using (unit, signal, run)
)
select unit, signal, run,
  case when reason is null then -sxy / sxx end as drift_ppm,
  case when reason is null then sqrt(greatest(syy - sxy * sxy / sxx, 0) / freedom / sxx) end as drift_uncertainty_ppm,
  offset_least_ns, offset_most_ns,
  backward + backward_inside as backward_jumps,
  jumps,
  case when backward_most_ns > abs(coalesce(largest_jump_ns, 0)) then -backward_most_ns else largest_jump_ns end
    as largest_jump_ns,
  stretches, messages, reason
from judged;
