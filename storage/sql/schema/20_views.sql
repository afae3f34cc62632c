-- Times are UTC. If a run's date is unknown (runs.date_known), they count from the run's start as 1970-01-01.

create or replace view signals as
select
  unit, signal, run,
  any_value(unit_of_measure) as unit_of_measure,
  sum(samples)::bigint as samples,
  sum(kept_raw)::bigint as kept_raw,
  sum(live)::bigint as live,
  make_timestamp_ns(min(t_first_ns)) as first_time,
  make_timestamp_ns(max(t_last_ns)) as last_time,
  arg_min(dt_ns, t_first_ns) / 1e9 as sample_interval_s,
  bool_or(irregular) as irregular,
  any_value(is_counts) as is_counts,
  any_value(scale) as scale,
  any_value("offset") as "offset",
  count(distinct epoch) as epochs,
  any_value(site) as site,
  any_value(station) as station,
  min(t_first_ns) as t_first_ns,
  max(t_last_ns) as t_last_ns,
  min(arrival_first_ns) as arrival_first_ns
from internal.lake_channels
group by unit, signal, run;

-- The macros `..._in` read only these files of the lake, of all where none are given: DuckDB opens every file of a table
-- to see whether it has rows of a channel.
create or replace macro internal.samples_in(paths) as table
select
  c.unit, c.signal, c.run,
  make_timestamp_ns(s.t_ns) as "time",
  -- in a question to all samples `case` takes a sixth less time than `coalesce`, with sums of floats
  case when s.base is not null then (s.base::double + s.above) * c.scale + c."offset" else s.value end as value,
  c.unit_of_measure,
  s.base + s.above as counts,
  s.t_ns, s.seq, s.flags,
  c.epoch
from internal.lake_samples s join internal.lake_channels c using (channel)
where paths is null or list_contains(paths, s.filename);

create or replace view samples as from internal.samples_in(null);

create or replace view internal.ended_runs as
select run, max(t_ns) as t_ns, coalesce(arg_max(document->>'$.outcome', arrival_ns), 'completed') as outcome
from internal.lake_documents where kind = 'RunEnded' group by run;

create or replace view runs as
with started as (
  select run, t_ns, arrival_ns, site, station, document
  from internal.lake_documents where kind = 'RunStarted'
  qualify row_number() over (partition by run order by arrival_ns) = 1
), files as (
  select run, arg_min(source, arrival_ns) as first, count(distinct source) as files
  from (select run, arrival_ns, document->>'$.source' as source from internal.lake_documents where kind = 'RunStarted')
  group by run
), stated as (
  select run, arg_max(document->>'$.details.time_zone', arrival_ns) as time_zone,
    -- a run begins where the key of its start says, and another place may be stated later
    arg_max(document->>'$.details.site', arrival_ns) filter (kind = 'StationStated') as site,
    arg_max(document->>'$.details.station', arrival_ns) filter (kind = 'StationStated') as station
  from internal.lake_documents
  where kind in ('RunStarted', 'StationStated')
  group by run
), released as (
  select run, count(distinct unit) as units,
    sum((document->>'$.planned_s')::double - (document->>'$.recorded_s')::double) as saved_s
  from internal.lake_documents where kind = 'UnitReleased' group by run
), resumed as (
  select run, count(*) as resumptions, sum(try_cast(document->>'$.gap_ns' as bigint)) / 1e9 as gap_s
  from internal.lake_documents where kind = 'RunResumed' group by run
), recorded as (
  select run, list(distinct unit order by unit) as units, sum(samples)::bigint as samples,
    sum(live)::bigint as live,
    any_value(site) as site, any_value(station) as station,
    min(t_first_ns) as t_first_ns, max(t_last_ns) as t_last_ns,
    count(distinct (unit, signal)) as signals, min(arrival_first_ns) as arrival_first_ns
  from internal.lake_channels group by run
)
select
  run,
  coalesce(z.site, s.site, r.site) as site,
  coalesce(z.station, s.station, r.station) as station,
  coalesce((s.document->>'$.date_known')::boolean, true) as date_known,
  case when coalesce((s.document->>'$.date_known')::boolean, true)
    then make_timestamp_ns(coalesce(s.t_ns, r.t_first_ns)) end as started,
  case when coalesce((s.document->>'$.date_known')::boolean, true)
    then make_timestamp_ns(coalesce(e.t_ns, r.t_last_ns)) end as ended,
  (coalesce(r.t_last_ns, e.t_ns) - coalesce(r.t_first_ns, s.t_ns)) / 1e9 as duration_s,
  coalesce(e.outcome, 'open') as outcome,
  coalesce(g.resumptions, 0) as resumptions,
  coalesce(g.gap_s, 0) as gap_s,
  r.units,
  r.signals,
  coalesce(r.samples, 0) as samples,
  coalesce(r.live, 0) as live,
  coalesce(u.units, 0) as released,
  u.saved_s,
  s.document->>'$.procedure' as "procedure",
  s.document->>'$.operator' as operator,
  s.document->>'$.lot' as lot,
  coalesce((s.document->>'$.simulated')::boolean, false) as simulated,
  case when f.files > 1 then concat(f.first, ' and ', f.files - 1, ' more') else f.first end as source,
  z.time_zone,
  make_timestamp_ns(coalesce(r.arrival_first_ns, s.arrival_ns)) as recorded
from recorded r
full join started s using (run)
left join internal.ended_runs e using (run)
left join resumed g using (run)
left join released u using (run)
left join stated z using (run)
left join files f using (run);

-- What people have excluded from every evaluation, and not included again: for each unit of a run the last word counts.
create or replace view exclusions as
with entered as (
  select run, nullif(document->>'$.unit', '') as unit, document->>'$.action' as action, document->>'$.reason' as reason,
    document->>'$.by' as by_whom, t_ns, arrival_ns, uid
  from internal.lake_documents where kind = 'ExclusionEntered' and coalesce(document->>'$.check', '') = ''
), tested as (
  select run, unit from internal.lake_documents
  where kind in ('StepStarted', 'UnitMounted') and run in (select run from entered)
  union
  select run, unnest(from_json(document->'$.units', '["varchar"]')) from internal.lake_documents
  where kind = 'RunStarted' and run in (select run from entered)
)
select t.run, t.unit, e.reason, e.by_whom, make_timestamp_ns(e.t_ns) as excluded, e.uid
from entered e join tested t on t.run = e.run and (e.unit is null or e.unit = t.unit)
qualify row_number() over (partition by t.run, t.unit order by e.arrival_ns desc, e.t_ns desc, e.uid) = 1
  and e.action = 'excluded';

-- Checks that were entered by hand and are not excluded.
create or replace view internal.standing_checks as
select * from internal.lake_documents
where kind = 'CheckEntered' and uid not in (
  select document->>'$.check' from internal.lake_documents
  where kind = 'ExclusionEntered' and document->>'$.check' <> ''
  group by all having arg_max(document->>'$.action', (arrival_ns, t_ns, uid)) = 'excluded'
);

-- A file that goes on from a step ends it again, and names the steps whose samples are all in it.
create or replace view internal.lake_steps as
with ended as (
  select *, document->>'$.step_uid' as step_uid from internal.lake_documents where kind = 'StepEnded'
)
select b.run, b.unit, b.uid, b.document->'$.words' as words, b.t_ns as t_start_ns, e.t_ns as t_end_ns,
  case when e.uid is null then 'open' else coalesce(e.document->>'$.outcome', 'completed') end as outcome
from (select * from internal.lake_documents where kind = 'StepStarted') b
left join (
  from ended qualify row_number() over (partition by run, unit, step_uid order by t_ns desc, uid) = 1
) e on e.run = b.run and e.unit = b.unit and e.step_uid = b.uid
anti join (
  select run, unit, unnest(from_json(document->'$.replaces', '["varchar"]')) as uid
  from ended where (document->'$.replaces') is not null
) r on r.run = b.run and r.unit = b.unit and r.uid = b.uid;

create or replace view steps as
select
  run, unit,
  row_number() over (partition by run, unit order by t_start_ns, s.uid) as "index",  -- two may start at one time
  words->>'$.procedure' as "procedure",
  words->>'$.step' as step,
  try_cast(words->>'$.repeat' as bigint) as repeat,
  words->>'$.position' as position,
  words->>'$.axis' as axis,
  words->>'$.phase' as phase,
  (words->>'$.rate_command_deg_per_s')::double as rate_command,
  (words->>'$.temperature_command_deg_c')::double as temperature_command,
  (words->>'$.frequency_hz')::double as frequency,
  (words->>'$.amplitude')::double as amplitude,
  (words->>'$.settle_s')::double as settle,
  (words->>'$.room')::boolean as room,
  make_timestamp_ns(t_start_ns) as started,
  make_timestamp_ns(t_end_ns) as ended,
  outcome,
  x.reason as excluded,
  t_start_ns, t_end_ns
from internal.lake_steps s left join exclusions x using (run, unit);

create or replace view estimates as
select
  unit, signal, run, estimator,
  make_timestamp_ns(t_ns) as "time",
  tau_s, value, lo, hi, unit_of_measure, confidence, edf, n, final, reason,
  samples, missing, sample_interval_s, t_ns, uid
from internal.lake_estimates
-- duplicates count once; with the parts of the name, filters on them are applied before
qualify row_number() over (partition by unit, signal, run, estimator, uid, tau_s order by arrival_ns) = 1;

create or replace view events as
select
  make_timestamp_ns(t_ns) as "time", kind, run, unit, document->>'$.signal' as signal, document, site, station, t_ns,
  uid
from internal.lake_documents;
