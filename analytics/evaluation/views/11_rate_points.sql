-- Steps of which a scale factor is made: the table turning about the input axis, or at rest before and after. `output`
-- is in deg/s where the source gives a rate, else in its own unit. Threshold and resolution tests hold a scale factor
-- too, whose steps are known by their names. Of an output that stood still at a rate the noise, and with it `u`, is not
-- known: the points' distances from their line are what is left to tell.
-- Steps in which one of a device's axes turned that the word `axis` names; of a shock or vibration it is theirs.
create or replace view internal.turned_axes as
select distinct run, unit, "index", axis_word_of(axis) as turned
from internal.gyro_steps
where axis is not null and phase is null and axis_word_of(axis) = named_axis_of(signal)
  and not regexp_matches(concat_ws(' ', "procedure", step), 'shock|冲击|vibration|振动');

create or replace view internal.rate_points as
select
  run, unit, signal, "procedure", repeat, temperature_command, room, position, axis, phase, product, "index", n,
  rate_command, input_rate, rate_command = 0 as at_rest,
  mean * coalesce(rate_factor / 3600, 1) as output,
  case when not stands_still then standard_uncertainty * coalesce(rate_factor / 3600, 1) end as u, stands_still,
  freedom,
  output_unit,
  temperature, station, time_zone, date_known, t_from_ns, t_to_ns, duration_s
from (
  select g.*, n > 1 and coalesce(sd = 0 or still >= 0.05 and n * still >= 10, false) as stands_still, t.turned
  from internal.gyro_steps g left join internal.turned_axes t using (run, unit, "index")
)
where n > 0 and rate_command is not null and frequency is null
  and (
    is_scale_factor_procedure("procedure") or not is_other_procedure("procedure")
    or (regexp_matches("procedure", '^(threshold|resolution)') and step in ('rest_before', 'rate', 'rest_after'))
  )
  -- an axis other than the one that is up, or turned, sees no rate; so does the input axis across the table's
  -- (misalignment)
  and not regexp_matches(coalesce(position, ''), '^[Oo][XxYy]_')
  and coalesce(axis_in(position) = named_axis_of(signal) or not regexp_matches(position, '_(up|down)$'), true)
  and coalesce(axis_word_of(axis) = named_axis_of(signal) or not starts_with("procedure", 'attitude_unit'), true)
  and coalesce(turned = named_axis_of(signal), true);
