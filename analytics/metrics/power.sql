-- id:        power
-- en:        Power consumption
-- zh:        功耗
-- unit:      W
-- better:    nearer_zero
-- grain:     unit, run, step, supply
-- parameters: supply, step
-- source:    GJB 2426A-2004 5.4
-- needs:     procedure power_consumption with supply_voltage (V) and supply_current (A) of the unit or of its supply
-- limits:    t
-- equation:  P = mean(U*I) for each supply
-- influence: supply_power: per_ppm(value)
-- python:    analytics.metrics.power:compute
-- of:        internal.power_procedures
-- The steps, with the supplies that fed them: the unit's own signals, else the instruments of the run.
with step as (
  select run, unit, "index", any_value(step) as step, min(t_from_ns) as t_from_ns, max(t_to_ns) as t_to_ns
  from step_means where regexp_matches("procedure", '^power|功耗')
  group by run, unit, "index"
), supply as (
  select run, unit as supply,
    bool_or(signal = 'supply_voltage' and unit_of_measure = 'V') as has_voltage,
    bool_or(signal = 'supply_current' and unit_of_measure = 'A') as has_current
  from signals where signal in ('supply_voltage', 'supply_current') group by all
), tested as (                          -- of all units, also where these are computed for some
  select distinct run, unit from internal.units_of_runs where regexp_matches("procedure", '^power|功耗')
), counted as (
  select run, count(*) as units from tested group by run
), fed as (
  select s.*, p.supply, p.has_voltage, p.has_current, t.units,
    bool_or(p.supply = s.unit) over (partition by s.run, s.unit) as has_own,
    -- the word `power` of its mounting names the supply of a unit
    json_extract_string(m.details, '$.power') as named
  from step s join counted t using (run) left join supply p on p.run = s.run
  left join units m on m.run = s.run and m.unit = s.unit
)
select *, supply = unit or units = 1 or supply = named as is_own from fed
where supply is null or case when has_own then supply = unit
  when named is not null then supply = named
  else supply not in (select unit from tested) end
order by run, unit, "index", supply
