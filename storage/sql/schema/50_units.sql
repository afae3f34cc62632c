-- The units tested in each run: one row for each unit that was mounted in a run or that the run names, as one of a file
-- without a list of units; joined by `using (run, unit)` to samples, steps and estimates. Of several mountings the last
-- one counts; all are in `events`.
create or replace view units as
with mounted as (
  select run, unit, site, station, t_ns, uid, document,
    count(*) over (partition by run, unit) as mountings
  from internal.lake_documents where kind = 'UnitMounted'
  qualify row_number() over (partition by run, unit order by t_ns desc, arrival_ns desc, uid desc) = 1
), started as (
  select run, site, station, t_ns, uid, document,
    document->>'$.lot' as lot,
    document->>'$.operator' as operator,
    coalesce((document->>'$.date_known')::boolean, true) as date_known
  from internal.lake_documents where kind = 'RunStarted'
  qualify row_number() over (partition by run order by arrival_ns) = 1
), stated as (
  select run,
    arg_max(document->>'$.details.site', arrival_ns) as site,
    arg_max(document->>'$.details.station', arrival_ns) as station
  from internal.lake_documents where kind = 'StationStated' group by run
), listed as (
  select * from mounted
  union all
  select s.run, s.unit, s.site, s.station, s.t_ns, s.uid, null, 0
  from (select *, unnest(from_json(document->'$.units', '["varchar"]')) as unit from started) s
  anti join mounted using (run, unit)
)
select
  m.unit, m.run,
  m.document->>'$.product' as product,
  -- statements about the unit take precedence over those about the run
  coalesce(m.document->>'$.lot', s.lot) as lot,
  m.document->>'$.slot' as slot,
  m.document->>'$.fixture' as fixture,
  coalesce(m.document->>'$.operator', s.operator) as operator,
  m.document->>'$.firmware' as firmware,
  -- free text: details->>'$.colour'
  (m.document->'$.details')::varchar as details,
  case when coalesce(s.date_known, true) then make_timestamp_ns(m.t_ns) end as mounted,
  m.mountings,
  coalesce(p.site, m.site) as site, coalesce(p.station, m.station) as station, m.t_ns, m.uid
from listed m left join started s using (run) left join stated p using (run);
