-- One row for each unit, signal, day, position and commanded temperature at which it stood still: the mean of all its
-- samples, raw, in deg/h. Rests of a test that turns the unit are left out: they are short, and their procedure's own.
create or replace view bias_by_day as
select unit, signal, day, position, temperature_command,
  sum(mean_deg_per_h * n) / sum(n) filter (mean_deg_per_h is not null) as bias,
  stddev(mean_deg_per_h) as stddev, count(*) as steps,
  sum(temperature * n) / sum(n) filter (temperature is not null) as temperature,
  list(distinct run order by run) as runs
from internal.still_steps
where day is not null and n > 0 and not turns
group by unit, signal, day, position, temperature_command;
comment on view bias_by_day is 'one row for each unit, signal, day, position and commanded temperature at which it stood still: its bias in deg/h';
