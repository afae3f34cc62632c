-- One row for each unit, signal and day on which it stood still: the mean of its biases, raw, in deg/h.
create or replace view bias_by_day as
select unit, signal, day, avg(mean_deg_per_h) as bias, stddev(mean_deg_per_h) as stddev, count(*) as steps,
  avg(temperature) as temperature, list(distinct run order by run) as runs
from static_steps
where day is not null
group by unit, signal, day;
comment on view bias_by_day is 'one row for each unit, signal and day on which it stood still: the mean of its biases in deg/h';
