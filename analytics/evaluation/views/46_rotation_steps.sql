-- Steps of system-level calibrations (CN 102680005), each once, with what the unit measured in them.
create or replace view internal.rotation_steps as
select run, unit, "index", any_value("procedure") as "procedure",
  any_value(coalesce(position, case when step like 'rotation_%' then step end)) as position,
  any_value(axis) as axis, any_value(latitude_deg) as latitude_deg, any_value(epoch) as epoch,
  min(t_from_ns) as t_from_ns, max(t_to_ns) as t_to_ns,
  list(signal order by signal) as signals, list(unit_of_measure order by signal) as units_of_measure
from step_means where regexp_matches("procedure", '^system_level|系统级')
group by run, unit, "index";
