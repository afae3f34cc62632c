-- Steps in which a unit stands still and records: the ground of the bias family, in deg/h. Where no rate was commanded
-- the table decides: above 0.01 deg/s it turns, and what the unit gives is no bias. `turns` says whether the unit turns
-- or vibrates in another step of the same procedure, whose steps at rest then belong to that. A dozen metrics stand on
-- them: a table. `several_axes`: those of a device of which the words of its position do not say which is the IRA; what
-- the Earth's rate adds is then unknown. Where the samples are no noise (`is_no_noise`: for a twentieth of the record alike, in a row
-- or at one value far more often than at others, or with outliers that may move the mean by more than the noise does) they say
-- nothing of how sure their mean and scatter are.
create or replace macro outliers_move_mean(outliers, excess) as outliers > 0 and outliers * ((1 + excess) ** 2 - 1) > 1;

create or replace table internal.still_steps as
with moving as (
  select *,
    frequency is not null or case when rate_command is null then abs(coalesce(input_rate, 0)) > 0.01
      else rate_command <> 0 end as moves
  from rate_steps
), turning as (
  select *, bool_or(moves) over (partition by run, unit, signal, "procedure") as turns,
    list_sort(list(distinct coalesce(named_axis_of(signal), 'unnamed')) over (partition by run, unit, "index")) as axes
  from moving
), placed as (
  select * exclude (axes),
    case when len(axes) > 1 and regexp_matches(position, '^(IRA|vertical)_') then array_to_string(axes, ', ') end
      as several_axes,
    coalesce(still >= 0.05 and n * still >= 10 or piled >= 0.05
      or outliers_move_mean(outliers, outlier_excess), false) as is_no_noise
  from turning
)
select * exclude (moves) replace (
    if(is_no_noise, null, sd_freedom) as sd_freedom, if(is_no_noise, null, freedom_1s) as freedom_1s,
    if(is_no_noise, null, freedom_10s) as freedom_10s, if(is_no_noise, null, freedom_100s) as freedom_100s),
  mean * deg_per_h as mean_deg_per_h,
  case when not is_no_noise then nullif(standard_uncertainty, 0) * abs(deg_per_h) end as u_deg_per_h,
  case when several_axes is null then earth_projection(position, latitude_deg, body_axis) end as earth_deg_per_h,
  -- the position tells how the Earth's rate enters, the latitude how much
  several_axes is null and earth_projection(position, 45, body_axis) is not null as is_attitude_known,
  body_axis is null and axis_in(position) is not null and side_in(position) is not null as lacks_body_axis,
  case when date_known then cast(timezone(time_zone, make_timestamptz(t_from_ns // 1000)) as date) end as day
from placed
where not moves;

create or replace view static_steps as
select * exclude (turns, several_axes, is_no_noise, lacks_body_axis) from internal.still_steps where n > 0;
