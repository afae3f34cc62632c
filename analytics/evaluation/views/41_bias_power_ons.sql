-- One bias for each power-on of a unit and attitude: the mean over its static steps, deg/h, with its uncertainty `u`. A
-- power-on is an epoch; where none was recorded, as in files, a repeat is taken for one (`counted_by`), else a step of a
-- procedure for repeatability, else the run.
-- Where the attitude tells how the Earth's rate enters, it is removed (`earth_rate`), so that stations of different
-- latitudes compare. Where the latitude of a power-on is not known, `lack` says so, and there is a raw bias of each
-- power-on as well: raw and corrected ones are never in one group.
create or replace view internal.bias_power_ons as
with known as (
  select *,
    coalesce(epoch, 'repeat ' || repeat, case when is_repeated then 'step ' || "index" else 'run' end) as power_on,
    case when epoch is not null then 'power-on' when repeat is not null then 'repeat' when is_repeated then 'step'
      else 'run' end as counted_by,
    bool_and(is_attitude_known) over attitude as is_placed,
    bool_and(earth_deg_per_h is not null) over attitude as is_corrected,
    nullif(min(run) over (partition by unit, signal, n, mean, sd, duration_s), run) as copy_of
  from (select *, regexp_matches(coalesce("procedure", ''), '^bias_repeatability|重复性') as is_repeated from internal.bias_steps)
  where n > 0 and deg_per_h is not null
  window attitude as (partition by unit, signal, position)
), listed as (
  select *, unnest(case when is_corrected then ['removed'] when is_placed then ['none', 'removed'] else ['none'] end)
    as earth_rate
  from known
)
select unit, signal, position, earth_rate, run, power_on,
  avg(mean_deg_per_h - case when earth_rate = 'removed' then earth_deg_per_h else 0 end order by t_from_ns, "index")
    as bias,
  -- null where that of a step is unknown, as of a single sample; steps err independently (Welch and Satterthwaite)
  case when count(u_deg_per_h) = count(*) then sqrt(sum(u_deg_per_h ** 2)) / count(*) end as u,
  -- the least that it can be: of white noise alone
  case when count(u_deg_per_h) = count(*) then
    sqrt(sum(least(u_deg_per_h ** 2, coalesce(white * deg_per_h ** 2 / nullif(duration_s, 0), u_deg_per_h ** 2))))
    / count(*) end as u_white,
  sum(u_deg_per_h ** 2) ** 2 / nullif(sum(u_deg_per_h ** 4 / greatest(freedom, 1)), 0) as freedom,
  sum(duration_s) as duration_s, any_value(counted_by) as counted_by,
  min(t_from_ns) as t_from_ns, min(day) as day, min(station) as station,
  list("index" order by "index") as steps,
  bool_or(is_repeated) as is_repeated,
  any_value(case
    when copy_of is not null and sd > 0 then 'runs ' || copy_of || ' and ' || run || ' have the same samples: they are '
      || 'one measurement, not two; leave one out'
    when earth_rate = 'removed' and earth_deg_per_h is null then 'run ' || run || ': ' || no_latitude() end) as lack
from listed
group by unit, signal, position, earth_rate, run, power_on;
