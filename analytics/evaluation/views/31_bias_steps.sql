-- Static steps that are records of a bias: of the procedures for it, and of others (files bring names of their own, or
-- none) in which the unit neither turns nor is flipped, shaken, heated or cooled. Also those without a sample.
-- `remark` flags what is shorter than the clauses ask for.
create or replace view internal.bias_steps as
with counted as (
  select *,
    count(distinct coalesce(temperature_command, 1e9)) over (partition by run, unit, signal, "procedure")
      as temperatures
  from internal.still_steps
)
select *,
  case
    when n = 0 then 'no sample in the evaluated part of the step'
    when deg_per_h is null then no_scale_factor(unit_of_measure)
  end as lack,
  -- no ground to refuse it: by the note of JJF 2014-2022 7.2.13.1 the user chooses the time
  case when duration_s < 3590 then
    'record of ' || round(duration_s)::bigint || ' s: the clauses ask for one hour as a rule' end as remark
from counted
where not turns and phase is null and axis is null and temperatures = 1
  and not is_no_bias_procedure("procedure");
