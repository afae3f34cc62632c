-- One bias for each power-on of a unit and attitude: the mean over its static steps, deg/h. A power-on is an epoch;
-- where none was recorded, as in files, it is a repeat, else a step of a procedure for repeatability, else the run.
-- The Earth's rate is removed where it is known for all power-ons in that attitude, so that stations of different
-- latitudes compare.
create or replace view bias_power_ons as
with known as (
  select *,
    coalesce(epoch, 'repeat ' || repeat, case when is_repeated then 'step ' || "index" else 'run' end) as power_on,
    bool_and(earth_deg_per_h is not null) over (partition by unit, signal, position) as is_corrected
  from (select *, regexp_matches(coalesce("procedure", ''), '^bias_repeatability|重复性') as is_repeated from bias_steps)
  where n > 0 and deg_per_h is not null
)
select unit, signal, position, run, power_on,
  avg(mean_deg_per_h - case when is_corrected then earth_deg_per_h else 0 end order by t_from_ns, "index") as bias,
  min(t_from_ns) as t_from_ns, min(day) as day,
  list("index" order by "index") as steps,
  bool_or(is_repeated) as is_repeated
from known
group by unit, signal, position, run, power_on;
