-- Steps of an attitude unit, a device with an output for each of three axes (JJF 1536-2015 clause 7).

-- At rest in positions: where its axes point, or the angle at which a table holds an axis that is level.
create or replace view internal.attitude_bias_steps as
select run, unit, signal, "procedure", repeat, "index", position, named_axis_of(signal) as own,
  axis_word_of(axis) as level_axis, mean, sd, n, duration_s, mean_deg_per_h, u_deg_per_h, freedom, latitude_deg,
  coalesce(scale_source, 'unknown') as scale_source,
  case when deg_per_h is null then no_scale_factor(unit_of_measure) end as no_scale
from internal.still_steps
where n > 0 and frequency is null and (
    starts_with("procedure", 'attitude_unit_bias')
    or regexp_matches(lower(position),
      '^([xyz]|heading|yaw|pitch|roll)[ _]*(axis|轴)?[ _:=朝]*(east|west|north|south|[ewns][^a-z]|[东西南北])')
  ) and named_axis_of(signal) is not null;

-- Turning about an axis: what the axis itself and the other two give. The rate about the axis is that of the table,
-- reversed where the axis points down.
create or replace view internal.attitude_turns as
select run, unit, signal, "procedure", repeat, "index", named_axis_of(signal) as own,
  coalesce(axis_word_of(axis), axis_in(position)) as turned,
  coalesce(side_in(position), 1) * coalesce(input_rate, rate_command) as rate, rate_command, input_rate_source,
  t_from_ns, t_to_ns, deg_per_h / 3600 as deg_per_s, is_integrated_output(signal) as is_integrated,
  n, duration_s, sd, mean, mean * deg_per_h / 3600 as output, standard_uncertainty * abs(deg_per_h) / 3600 as u, freedom,
  coalesce(scale_source, 'unknown') as scale_source,
  case when deg_per_h is null then no_scale_factor(unit_of_measure) end as no_scale
from rate_steps
where n > 0 and rate_command <> 0 and frequency is null and named_axis_of(signal) is not null
  and regexp_matches("procedure", '^(attitude_unit_)?misalignment|失准角')
  and not regexp_matches(coalesce(position, ''), '^[Oo][XxYy]_');

-- 1, and null where a bias by equal angles may hold what its axis sees of the Earth's vertical rate.
create or replace macro level_rate_is_known(parameters) as
  case when parameters->>'$.method' = 'equal angles' and parameters->>'$.vertical_rate_deg_per_h' is null
    then null else 1 end;
