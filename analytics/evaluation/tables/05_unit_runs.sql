-- Who was tested where and when: one row for each unit of a run that has completed steps. `day` is the station's own.
create or replace view unit_runs as
select run, unit,
  min(product) as product, min(lot) as lot, min(site) as site, min(station) as station,
  min(fixture) as fixture, min(slot) as slot, min(operator) as operator,
  bool_and(date_known) as date_known,
  case when bool_and(date_known) then
    cast(timezone(min(time_zone), make_timestamptz(min(t_start_ns) // 1000)) as date) end as day,
  min(t_start_ns) as t_start_ns, max(t_to_ns) as t_end_ns
from step_means
group by run, unit;
comment on view unit_runs is 'one row for each unit of a run with completed steps: product, lot, station, fixture, slot, day';
