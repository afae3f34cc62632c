-- Static steps that are records of a bias: of the procedures for it, and of others (files bring names of their own, or
-- none) in which the unit neither turns nor is flipped, shaken, heated or cooled. Also those without a sample.
-- `remark` flags what is shorter than the clauses ask for, counted by the samples that are there, samples that are no noise, and an
-- attitude that does not say which axis it means.
create or replace macro remark_on_samples(n, still, sd, outliers, outlier_excess, piled, piled_at, repeated, measure) as
  nullif(concat_ws('; ',
    case when n > 1 and sd = 0 then 'all ' || n || ' samples are alike: the output is frozen, or its resolution too '
        || 'coarse to show noise'
      when still >= 0.05 and n * still >= 10 then round(n * still)::bigint || ' of ' || n || ' samples in a row are alike: the output '
        || 'was frozen, or its resolution is too coarse to show noise'
      when piled > 0 then if(n > 1000000, 'about ', '') || round(n * piled)::bigint || ' of ' || n || ' samples are at one value or two, as at '
        || printf('%.5g', piled_at) || ' ' || measure || ': clipped at an end of the range, or lost samples written as it' end,
    case when repeated > 0 then format('at least {:.2g} % of the samples repeat the one before, which resolution and noise do not explain: '
      || 'as of a logger that is faster than the gyro, or of lost samples written as the last one', 100 * repeated) end,
    case when outliers_move_mean(outliers, outlier_excess) then format('isolated outliers ({}) raise the noise {:.3g} times '
        || 'and may move the mean by more than the noise does: it has no interval', outliers, 1 + outlier_excess)
      when outliers > 0 and outlier_excess >= 0.01 then format('isolated outliers ({}) raise the noise by {:.0f} %',
        outliers, 100 * outlier_excess) end), '');

create or replace table internal.bias_steps as
with counted as (
  select *,
    count(distinct coalesce(temperature_command, 1e9)) over (partition by run, unit, signal, "procedure")
      as temperatures,
    case when lacks_samples(n, expected) then n / expected else 1.0 end as covered
  from internal.still_steps
), covered as (
  select *, duration_s * covered as covered_s from counted
)
select *,
  case
    when n = 0 then 'no sample in the evaluated part of the step'
    when deg_per_h is null then no_scale_factor(unit_of_measure)
  end as lack,
  -- no ground to refuse it: by the note of JJF 2014-2022 7.2.13.1 the user chooses the time
  nullif(concat_ws('; ',
    remark_on_samples(n, still, sd, outliers, outlier_excess, piled, piled_at, repeated, unit_of_measure), scale_remark,
    case when several_axes is not null then 'the position ' || position || ' does not say which of the axes '
      || several_axes || ' it means, so the Earth''s rate stays in: name the axis that is up, as Z_up' end,
    case when abs(chamber_temperature - temperature_command) > 3 then
      format('the chamber was at {:.1f} degC, {:.1f} were commanded', chamber_temperature, temperature_command) end,
    case when temperature_moved > 10 then format('the temperature moved: its standard deviation of {:.1f} degC is that '
      || 'of a ramp over {:.0f} degC', temperature_moved / sqrt(12), temperature_moved) end,
    case when covered < 1 then n || ' of ' || expected || ' samples are there, as of '
      || round(covered_s)::bigint || ' s of ' || round(duration_s)::bigint || ' s' end,
    case when covered_s < 3590 then
      'record of ' || round(covered_s)::bigint || ' s: the clauses ask for one hour as a rule' end), '') as remark
from covered
where not turns and phase is null and axis is null and temperatures = 1
  and not is_no_bias_procedure("procedure");
