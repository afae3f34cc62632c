-- id:        polarity
-- en:        Polarity
-- zh:        极性
-- unit:      1
-- better:    neither
-- grain:     unit, signal, run
-- parameters: repeat, position, rate_deg_per_s, forwards, backwards
-- source:    GJB 2426A-2004 5.7
-- needs:     procedure polarity: a rate along the positive input axis, and the other way
-- limits:    given
-- equation:  sign(F(+Omega) - F(-Omega)), right-hand rule
-- influence: none: a sign is right or wrong
-- of:        internal.polarity_procedures
-- A sign is right or wrong: it is given where the difference is beyond its 99.9 % limits, with no interval around it.
with turned as (
  select run, unit, signal, repeat, position,
    arg_max(mean, input_rate) filter (rate_command > 0) as forwards,
    arg_min(mean, input_rate) filter (rate_command < 0) as backwards,
    arg_max(standard_uncertainty, input_rate) filter (rate_command > 0) as u_forwards,
    arg_min(standard_uncertainty, input_rate) filter (rate_command < 0) as u_backwards,
    arg_max(freedom, input_rate) filter (rate_command > 0) as freedom_forwards,
    arg_min(freedom, input_rate) filter (rate_command < 0) as freedom_backwards,
    min(unit_of_measure) as unit_of_measure,
    max(abs(input_rate)) as rate, list("index" order by "index") as steps, sum(n)::bigint as n
  from internal.gyro_steps
  where n > 0 and rate_command <> 0 and frequency is null and regexp_matches("procedure", '^polarity|极性')
  group by all
), compared as (
  select *, sqrt(u_forwards ** 2 + u_backwards ** 2) as u,
    welch_freedom(u_forwards, freedom_forwards, u_backwards, freedom_backwards) as freedom
  from turned
), judged as (
  select *,
    case
      when forwards is null then 'no record of a positive rate, the clause asks for both directions (5.7.3)'
      when backwards is null then 'no record of a negative rate, the clause asks for both directions (5.7.3)'
      when abs(forwards - backwards) <= coalesce(u * student_quantile(0.001, freedom), 0) then
        format('the outputs {:g} and {:g} {} at +{:g} and -{:g} deg/s cannot be distinguished',
          forwards, backwards, unit_of_measure, rate, rate)
    end as lack
  from compared
)
select
  unit, signal, run,
  case when lack is null then sign(forwards - backwards)::double end as value,
  value as lo, value as hi,
  null::double as standard_uncertainty,
  freedom,
  n,
  {repeat: repeat, position: position, rate_deg_per_s: rate, forwards: forwards, backwards: backwards} as parameters,
  [run] as runs, steps,
  lack as reason
from judged
