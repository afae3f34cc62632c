-- Steps in which a unit stands still and records: the ground of the bias family, in deg/h.
create or replace view static_steps as
select *,
  mean * deg_per_h as mean_deg_per_h,
  standard_uncertainty * abs(deg_per_h) as u_deg_per_h,
  earth_projection(position, latitude_deg) as earth_deg_per_h,
  case when date_known then cast(timezone(time_zone, make_timestamptz(t_from_ns // 1000)) as date) end as day
from rate_steps
where n > 0 and coalesce(rate_command, 0) = 0 and frequency is null;
