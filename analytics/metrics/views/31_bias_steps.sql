-- Static steps that are records of a bias: of the procedures for it, and of others (files bring names of their own, or
-- none) in which the unit neither turns nor is flipped, shaken, heated or cooled. Also those without a sample.
create or replace view bias_steps as
with told as (
  select *,
    count(distinct coalesce(temperature_command, 1e9)) over (partition by run, unit, signal, "procedure")
      as temperatures
  from still_steps
)
select *,
  case
    when n = 0 then 'no sample in the evaluated part of the step'
    when deg_per_h is null then
      'no scale factor for an output in ' || unit_of_measure || ': measure it or give the nominal one of the product'
    when duration_s < 3590 then
      'the record is ' || round(duration_s)::bigint || ' s long, the clauses ask for at least one hour'
  end as lack
from told
where not turns and phase is null and axis is null and temperatures = 1
  and not regexp_matches(coalesce("procedure", ''),
    '^(scale_factor|range|rates|threshold|resolution|polarity|misalignment|gyro_separation|accelerometer_separation'
    '|attitude_unit|bandwidth|startup_time|warmup_time|power|random_walk|visual|system_level'
    '|bias_(temperature|acceleration|shock|vibration))');
