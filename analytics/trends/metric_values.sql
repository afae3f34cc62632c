-- The values of a metric, with when, where and in which lot each was measured.
with own_lots as (                      -- a unit is of one lot, where its runs agree
  select unit, min(lot) as lot from step_means where $unit = '' or unit = $unit
  group by unit having min(lot) = max(lot)
), chosen as (
  select row_number() over () as number, *
  from unit_metrics where metric = $metric and ($unit = '' or unit = $unit)
), placed as (
  select c.number,
    max(s.t_to_ns) as t_ns,
    arg_max(s.station, s.t_to_ns) as station,
    arg_max(s.lot, s.t_to_ns) as lot,
    arg_max(s.fixture, s.t_to_ns) as fixture,
    arg_max(s.product, s.t_to_ns) as product,
    bool_and(s.date_known) as date_known
  from (select *, unnest(case when len(runs) > 0 then runs else [run] end) as in_run from chosen) c
  join step_means s on s.run = c.in_run and s.unit = c.unit and ($unit = '' or s.unit = $unit)
    and (len(c.runs) > 1 or coalesce(len(c.steps), 0) = 0 or list_contains(c.steps, s."index"))
  group by c.number
)
select c.unit, c.signal, coalesce(c.run, c.runs[-1]) as run, c.value, c.lo, c.hi, c.standard_uncertainty, c.unit_of_measure,
  c.standard, c.parameters, c.reason,
  p.t_ns, coalesce(p.date_known, r.date_known, false) as date_known,
  coalesce(p.station, u.station, r.station) as station,
  coalesce(p.lot, u.lot, r.lot, w.lot) as lot,
  coalesce(p.fixture, u.fixture) as fixture,
  coalesce(p.product, u.product) as product,
  epoch_ns(coalesce(r.started, r.recorded)) as recorded_ns,
  c.steps, c.run as own_run
from chosen c
left join placed p using (number)
left join units u on u.run = coalesce(c.run, c.runs[-1]) and u.unit = c.unit
left join own_lots w on w.unit = c.unit
left join runs r on r.run = coalesce(c.run, c.runs[-1])
