-- Steps in which a unit stands still and records: the ground of the bias family, in deg/h. Where no rate was commanded
-- the table decides: above 0.01 deg/s it turns, and what the unit gives is no bias. `turns` says whether the unit turns
-- or vibrates in another step of the same procedure, whose steps at rest then belong to that. A dozen metrics stand on
-- them: a table.
create or replace table internal.still_steps as
with moving as (
  select *,
    frequency is not null or case when rate_command is null then abs(coalesce(input_rate, 0)) > 0.01
      else rate_command <> 0 end as moves
  from rate_steps
), turning as (
  select *, bool_or(moves) over (partition by run, unit, signal, "procedure") as turns from moving
)
select * exclude (moves),
  mean * deg_per_h as mean_deg_per_h,
  standard_uncertainty * abs(deg_per_h) as u_deg_per_h,
  earth_projection(position, latitude_deg, signal) as earth_deg_per_h,
  -- the position tells how the Earth's rate enters, the latitude how much
  earth_projection(position, 45, signal) is not null as is_attitude_known,
  case when date_known then cast(timezone(time_zone, make_timestamptz(t_from_ns // 1000)) as date) end as day
from turning
where not moves;

create or replace view static_steps as
select * exclude (turns) from internal.still_steps where n > 0;
