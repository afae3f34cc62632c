-- What the station of each run states of its measurement standards (a JSON text), when the run began, null where its date
-- is not known, and when that was recorded.
create or replace table internal.run_standards as
with stated as (
  select run, t_ns, arrival_ns, document->'$.details' as details,
    coalesce((document->>'$.date_known')::boolean, true) as date_known,
    case kind when 'RunStarted' then -arrival_ns else arrival_ns end as place, kind
  from internal.lake_documents where kind in ('RunStarted', 'StationStated')
)
select run,
  arg_max(details->>'$.standards', place) as standards,
  arg_max(details->>'$.time_zone', place) as time_zone,
  min(t_ns) filter (kind = 'RunStarted' and date_known) as t_ns,
  min(arrival_ns) filter (kind = 'RunStarted') as recorded_ns
from stated group by run;
