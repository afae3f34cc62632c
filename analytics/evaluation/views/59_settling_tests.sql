-- Tests of the procedures that match a regular expression, with what was measured of the unit before: its last bias
-- without the Earth's rate, and its scale factor. In a rate test a unit's scale-factor error is not part of the
-- start-up: without a measured scale factor the end of the record is the reference.
create or replace macro settling_tests(of_procedure) as table
with zero as (
  select unit, signal, run, t_to_ns, mean_deg_per_h - earth_deg_per_h as bias, u_deg_per_h
  from internal.bias_steps where lack is null and earth_deg_per_h is not null
), test as (
  select *, coalesce(abs(rate_command), 0) > 0 as is_rate,
    -- what a step leaves out to settle is what is measured here
    coalesce(t_from_ns - round(time_since_power_on_s * 1e9)::bigint, t_start_ns) as on_ns
  from rate_steps where regexp_matches("procedure", of_procedure)
)
select s.unit, s.signal, s.run, s."index", s.position, s.rate_command, s.is_rate, s.on_ns, s.t_to_ns, s.n, s.product,
  b.startup_band_deg_per_h as band, no_scale_factor(s.unit_of_measure) as no_scale,
  s.time_since_power_on_s is not null as is_powered, g.kept_raw < g.samples as is_dropped,
  coalesce(case when s.is_rate then coalesce(s.rate_factor, 3600) / f.value end, s.deg_per_h) as deg_per_h,
  case when not s.is_rate then 0 when f.value is not null then s.input_rate * 3600 end
    -- the axis of a rate table stands upright
    + case when s.is_rate and s.position is null then earth_projection('IRA_up', s.latitude_deg, s.body_axis)
      else earth_projection(s.position, s.latitude_deg, s.body_axis) end + z.bias as expected,
  z.u_deg_per_h as expected_u, z.run as zero_run
from test s
join signals g on g.run = s.run and g.unit = s.unit and g.signal = s.signal
left join internal.run_products b on b.unit = s.unit and b.run = s.run
asof left join internal.scale_factors f
  on f.unit = s.unit and f.signal = s.signal and f.t_to_ns <= s.on_ns
  and f.output_unit = case when s.rate_factor is null then s.unit_of_measure else 'deg/s' end
asof left join zero z on z.unit = s.unit and z.signal = s.signal and z.t_to_ns <= s.on_ns;
