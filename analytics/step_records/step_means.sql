-- The records of one or more runs, from what was reduced of them (table reduced): words of the step, who was tested
-- where, and what acted on the unit meanwhile. One row for each signal of each completed step of each unit.
with step as (
  select s.*,
    s.t_start_ns + round(coalesce(s.settle, 0) * 1e9)::bigint as t_from_ns,
    s.t_end_ns as t_to_ns
  from steps s
  where s.outcome = 'completed' and s.excluded is null and s.run in (select run from internal.reduced_runs)
), stepped as (
  select distinct run, unit from step
), power as (                           -- the power-on in force, and when it was
  select run, unit, t_ns, document->>'$.epoch' as epoch
  from events where kind = 'PowerOn' and run in (select run from internal.reduced_runs)
), stated as (                          -- of the station: how the run began, and what was declared of it later
  select run, document->'$.details' as details, case kind when 'RunStarted' then -arrival_ns else arrival_ns end as place
  from internal.lake_documents
  where kind in ('RunStarted', 'StationStated') and run in (select run from internal.reduced_runs)
), about as (
  select run,
    arg_max(details->>'$.time_zone', place) as time_zone,
    try_cast(arg_max(details->>'$.latitude_deg', place) as double) as latitude_deg,
    try_cast(arg_max(details->>'$.gravity_m_per_s2', place) as double) as gravity
  from stated group by run
), spread as (                          -- of temperatures: how far they moved, from what is no white noise, as of a ramp
  select *, (deg_c(1, unit_of_measure) - deg_c(0, unit_of_measure)) * sqrt(12 * greatest(0,
    sd ** 2 - if(isfinite(white), white, 0) * (n - 1) / nullif((t_to_ns - t_from_ns) / 1e9, 0))) as moved_deg_c
  from internal.reduced
), beside as (                          -- signals of instruments, which have no steps of their own
  select r.* from spread r anti join stepped using (run, unit)
), around as (
  select s.run, s.unit, s."index",
    min(deg_c(b.mean, b.unit_of_measure)) filter (b.signal = 'chamber_temperature') as chamber_temperature,
    max(b.moved_deg_c) filter (b.signal = 'chamber_temperature') as chamber_moved,
    any_value(if(b.unit_of_measure = 'deg/s', b.mean, deg_per_h(b.mean, b.unit_of_measure) / 3600) order by b.unit)
      filter (b.signal = 'table_rate' and deg_per_h(b.mean, b.unit_of_measure) is not null) as table_rate
  from step s join beside b on b.run = s.run and b.t_from_ns = s.t_from_ns and b.t_to_ns = s.t_to_ns
  group by all
), own as (
  select run, unit, t_from_ns, t_to_ns,
    coalesce(min(deg_c(mean, unit_of_measure)) filter (signal = 'temperature'),
      min(deg_c(mean, unit_of_measure)) filter (signal in ('陀螺温度', '陀螺仪温度')),
      min(deg_c(mean, unit_of_measure)) filter (signal in ('产品温度', '温度'))) as temperature,
    min(deg_c(mean, unit_of_measure)) filter (signal = 'chamber_temperature') as chamber_temperature,
    coalesce(max(moved_deg_c) filter (signal = 'temperature'), max(moved_deg_c) filter (signal in ('陀螺温度', '陀螺仪温度')),
      max(moved_deg_c) filter (signal in ('产品温度', '温度'))) as moved,
    max(moved_deg_c) filter (signal = 'chamber_temperature') as chamber_moved,
    min(if(unit_of_measure = 'deg/s', mean, deg_per_h(mean, unit_of_measure) / 3600)) filter (signal = 'table_rate')
      as table_rate
  from spread group by all
)
select
  s.run, s.unit, r.signal, s."index",
  u.site, u.station, coalesce(m.lot, u.lot) as lot, m.product, m.fixture, m.slot, m.firmware,
  coalesce(m.operator, u.operator) as operator,
  u.date_known, u.simulated,
  -- one that nobody knows leaves the day unknown
  case when a.time_zone is null then 'UTC' else z.name end as time_zone,
  case when abs(a.latitude_deg) <= 90 then a.latitude_deg end as latitude_deg,
  case when a.gravity > 0 then a.gravity end as gravity_m_per_s2,
  coalesce(s."procedure", u."procedure") as "procedure",
  s.step, s.repeat, s.position, s.axis, s.phase,
  s.rate_command, s.temperature_command, s.frequency, s.amplitude, s.settle, coalesce(s.room, false) as room,
  p.epoch, (r.t_from_ns - p.t_ns) / 1e9 as time_since_power_on_s,
  s.t_start_ns, r.t_from_ns, r.t_to_ns, (r.t_to_ns - r.t_from_ns) / 1e9 as duration_s,
  coalesce(o.temperature, o.chamber_temperature, x.chamber_temperature, s.temperature_command) as temperature,
  case
    when o.temperature is not null then 'unit'
    when coalesce(o.chamber_temperature, x.chamber_temperature) is not null then 'chamber'
    when s.temperature_command is not null then 'command'
  end as temperature_source,
  coalesce(o.chamber_temperature, x.chamber_temperature) as chamber_temperature,
  case
    when o.temperature is not null then o.moved
    else coalesce(o.chamber_moved, x.chamber_moved)
  end as temperature_moved,
  coalesce(o.table_rate, x.table_rate, s.rate_command) as input_rate,
  case
    when coalesce(o.table_rate, x.table_rate) is not null then 'table'
    when s.rate_command is not null then 'command'
  end as input_rate_source,
  r.unit_of_measure,
  r.n, r.expected, r.whole_seconds, r.mean, r.sd, r.sd_freedom, r.standard_uncertainty, r.freedom, r.n_effective, r.white, r.flicker, r.walk, r.still,
  r.outliers, r.outlier_excess, r.piled, r.piled_at, r.repeated,
  r.n_1s, r.sd_1s, r.freedom_1s, r.n_10s, r.sd_10s, r.freedom_10s, r.n_100s, r.sd_100s, r.freedom_100s,
  r.reason
from step s
join internal.reduced r on r.run = s.run and r.unit = s.unit and r.t_from_ns = s.t_from_ns and r.t_to_ns = s.t_to_ns
left join own o on o.run = s.run and o.unit = s.unit and o.t_from_ns = s.t_from_ns and o.t_to_ns = s.t_to_ns
left join around x on x.run = s.run and x.unit = s.unit and x."index" = s."index"
left join runs u on u.run = s.run
left join units m on m.run = s.run and m.unit = s.unit
left join about a on a.run = s.run
left join pg_timezone_names() z on lower(z.name) = lower(a.time_zone)
asof left join power p on p.run = s.run and p.unit = s.unit and p.t_ns <= s.t_from_ns
order by s.run, s.unit, r.signal, s."index"
