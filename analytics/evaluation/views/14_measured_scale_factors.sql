-- The scale factors that other metrics may use: all that meet what one of the standards asks for, each from the end of
-- its measurement on; of a run at several temperatures those at room temperature. One that was measured with the axis
-- down counts where the run has none with it up; its sign is that of the table where this turned against the axis.
-- An output that is a rate and shows less than half or more than twice the table's did not turn about its own axis.
create or replace macro measured_scale_factors(source) as table
with usable as (
  select *, regexp_matches(coalesce(position, ''), '_down$') as is_down
  from scale_results(source)
  where lack is null and k <> 0
    and (output_unit <> 'deg/s' or abs(k) between 0.5 and 2)
    and (temperature_command is null or abs(temperature_command - 20) <= 10)
  qualify not is_down or bool_and(is_down) over (partition by unit, signal, run, output_unit)
)
select unit, signal, run, output_unit, any_value(if(is_down, abs(k), k) order by standard) as value,
  max(t_to_ns) as t_to_ns
from usable
group by unit, signal, run, output_unit, steps
qualify row_number() over (partition by unit, signal, output_unit, max(t_to_ns) order by run, steps) = 1;

create or replace table internal.scale_factors as from measured_scale_factors('internal.scale_fits');
