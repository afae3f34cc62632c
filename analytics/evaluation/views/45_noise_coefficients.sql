-- Noise coefficients of IEEE 952 that were fitted to the Allan curve of a finished run: a row for each of a unit that
-- did nothing in that run but be at rest in one step. One that the record does not show has no value; `reason` says
-- by how much it is bounded. Where the curve departs from the model by more than a quarter, as in
-- `gyrofleet allan --fit`, or the output stood still for a part of the record, values have no interval. A step of the procedure for it without a fit has rows too.
-- Five metrics stand on them: a table.
create or replace table internal.noise_coefficients as
with still as (
  select *, count(*) over (partition by run, unit, signal) as still_steps from internal.bias_steps where n > 0
), counted as (
  select run, unit, signal, count(*) as all_steps from step_means group by all
), expected as (
  select s.*, f.document,
    unnest(['quantization_noise', 'angle_random_walk', 'bias_instability', 'rate_random_walk', 'rate_ramp'])
      as coefficient
  from still s
  join counted c on c.run = s.run and c.unit = s.unit and c.signal = s.signal and c.all_steps = 1
  left join internal.fitted_noise f on f.run = s.run and f.unit = s.unit and f.signal = s.signal
  where f.document is not null or regexp_matches(s."procedure", '^allan|Allan')
), parsed as (
  -- the fit is of the output in deg/h by its unit, the coefficients are of the input
  select *, document->'$.coefficients'->coefficient as found, abs(deg_per_h / rate_factor) as scale,
    coalesce((document->>'$.coefficients.misfit')::double > 0.25, false) as is_misfit, is_misfit or is_no_noise as is_refused,
    remark_on_samples(n, still, sd, outliers, outlier_excess, piled, piled_at, repeated, unit_of_measure) as still_remark
  from expected
)
select unit, signal, run, "index", coefficient, n, duration_s,
  case when (found->>'$.observable')::boolean then (found->>'$.value')::double * scale end as value,
  case when not is_refused then (found->>'$.lo')::double * scale end as lo,
  case when not is_refused then (found->>'$.hi')::double * scale end as hi,
  case when not is_refused then ((found->>'$.hi')::double - (found->>'$.lo')::double) * scale / (2 * 1.959963984540054) end
    as standard_uncertainty,
  case when is_misfit then 'the terms of the noise model do not describe the Allan curve, which departs from them by '
    || round(100 * (document->>'$.coefficients.misfit')::double)::bigint || ' %, as where a line is in the spectrum: the value has '
    || 'no interval' end as misfit_remark, still_remark,
  (document->>'$.coefficients.misfit')::double as misfit,
  (document->>'$.coefficients.markov.correlation_s')::double as markov_correlation_s,
  case
    when document is null then
      'no noise fit is stored of this run: record with the estimates of the worker, or see `gyrofleet allan`'
    when found is null then coalesce(document->>'$.reason', 'the noise fit of this run has no such term')
    when not (found->>'$.observable')::boolean then found->>'$.reason'
  end as reason
from parsed;

-- Rows of the metric of one coefficient.
create or replace macro fitted_coefficient(name) as table
select unit, signal, run, value, lo, hi, standard_uncertainty, null::double as freedom, n,
  {method: 'allan', duration_s: round(duration_s), misfit: misfit, markov_correlation_s: markov_correlation_s,
    remark: nullif(concat_ws('; ', misfit_remark, still_remark), '')}
    as parameters,
  [run] as runs, ["index"] as steps, reason
from internal.noise_coefficients
where coefficient = name;
