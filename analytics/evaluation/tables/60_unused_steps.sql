-- Steps that no characteristic rests on, not even one without a value: what was recorded, and why nothing is made of it.
create or replace view unused_steps as
with rested as (
  select distinct unit, run, unnest(steps) as "index" from (select unit, unnest(runs) as run, steps from unit_metrics)
), output as (
  select s.*, is_output_name(signal) or r.deg_per_h is not null as is_output
  from step_means s left join internal.rate_units r using (unit_of_measure)
  where not is_instrument_name(s.signal)
    and (is_output_name(signal) or r.deg_per_h is not null or (
      -- might be a gyro's output under another name
      s.unit_of_measure in ('V', 'mV', 'uV', 'A', 'mA', 'uA', 'count', 'LSB', 'count/s', 'LSB/s', 'Hz', 'kHz', 'MHz')
      and not regexp_matches(lower(s.signal),
        'suppl|power|volt|curr|temp|acc|mag|baro|press|humid|count|status|flag|seq|time|crc|clock|angle|reference|温度|电压|电流|功率|计数|状态')
    ) or (
      s.unit_of_measure in ('deg', 'arcmin', 'arcsec', 'rad', 'mrad', 'urad')
      and regexp_matches(lower(s.signal), '^(d|delta)?_?(angle|theta|phi)|increment') and not is_integrated_output(s.signal)
    ))
)
select o.unit, o.signal, o.run, o."index", o."procedure", o.step, o.position, o.unit_of_measure, o.n,
  case when not o.is_output and o.unit_of_measure in ('deg', 'arcmin', 'arcsec', 'rad', 'mrad', 'urad') then
      'signal ' || o.signal || ' in ' || o.unit_of_measure || ' is not taken for the output of a gyro: call an angle turned '
      || 'so far angle_x, angle_y or angle_z, and sum up increments to it'
    when not o.is_output then
      'signal ' || o.signal || ' in ' || o.unit_of_measure || ' is not taken for the output of a gyro: call it rate, or '
      || 'rate_x, rate_y, rate_z'
    when o.n = 0 then 'signal ' || o.signal || ' has no sample in them: compare the times of the files, their time zone '
      || 'and --start'
    else 'no characteristic is made of a step of procedure ' || coalesce(o."procedure", '(not given)')
      || coalesce(', position ' || o.position, '')
      || coalesce(', phase ' || o.phase || case when lower(o.phase) in ('before', 'during', 'after') then ''
        else ' (a phase is before, during or after a shock or a vibration: give the column another name)' end, '')
      || case when o.rate_command <> 0 then ', at a rate'
        when o.rate_command is null and is_scale_factor_procedure(o."procedure") then ', without a rate_command' else '' end
  end as reason
from output o
anti join rested r on o.is_output and r.unit = o.unit and r.run = o.run and r."index" = o."index"
union all by name
select s.unit, s.run, s."index", s."procedure", s.step, s.position,
  'run ' || s.run || ' is excluded from evaluation: ' || s.excluded as reason
from steps s where s.excluded is not null;
comment on view unused_steps is 'steps that no characteristic rests on, with the reason: what was recorded and is not judged';
