-- The scale factors that other metrics may use: all that meet what one of the standards asks for, each from the end of
-- its measurement on; of a run at several temperatures those at room temperature, not after the axis was turned over.
create or replace macro measured_scale_factors(source) as table
select unit, signal, run, any_value(k order by standard) as value, max(t_to_ns) as t_to_ns
from scale_results(source)
where lack is null and k <> 0
  and (temperature_command is null or abs(temperature_command - 20) <= 10)
  and not regexp_matches(coalesce(position, ''), '_down$')
group by unit, signal, run, steps;
