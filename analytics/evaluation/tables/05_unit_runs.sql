-- Who was tested where and when: one row for each unit of a run that has completed steps. `day` is the station's own.
-- A run that does not say the lot of a unit has that of its other runs, where these agree: a unit is of one lot.
create or replace view unit_runs as
with each_run as (
select run, unit,
  min(product) as product, min(lot) as lot, min(site) as site, min(station) as station,
  min(fixture) as fixture, min(slot) as slot, min(operator) as operator,
  bool_and(date_known) as date_known,
  case when bool_and(date_known) then
    cast(timezone(min(time_zone), make_timestamptz(min(t_start_ns) // 1000)) as date) end as day,
  min(t_start_ns) as t_start_ns, max(t_to_ns) as t_end_ns
from step_means
group by run, unit
)
select * replace (coalesce(lot, case when min(lot) over own = max(lot) over own then min(lot) over own end) as lot)
from each_run
window own as (partition by unit);
comment on view unit_runs is 'one row for each unit of a run with completed steps: product, lot, station, fixture, slot, day';
