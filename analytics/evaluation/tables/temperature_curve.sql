-- Bias against temperature: one row for each static step whose temperature is known.
create or replace view temperature_curve as
select unit, signal, run, "index" as step, "procedure", temperature, temperature_source, room,
  mean_deg_per_h as bias, u_deg_per_h as standard_uncertainty, freedom
from static_steps
where temperature is not null;
comment on view temperature_curve is 'bias in deg/h against temperature: one row for each static step';
