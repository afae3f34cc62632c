-- Steps on an angular-vibration table, with the scale factor that was last measured before the step ended.
create or replace view internal.vibration_steps as
select g.run, g.unit, g.signal, g."procedure", g.position, g.axis, g."index", g.frequency, g.amplitude,
  g.t_from_ns, g.t_to_ns, g.rate_factor, f.value as scale_factor, f.run as scale_run
from internal.gyro_steps g
asof left join internal.scale_factors f
  on f.unit = g.unit and f.signal = g.signal and f.output_unit = g.output_unit and f.t_to_ns <= g.t_to_ns
where g.frequency > 0 and g.phase is null;
