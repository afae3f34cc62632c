-- id:        scale_factor_asymmetry
-- en:        Scale-factor asymmetry
-- zh:        标度因数不对称度
-- unit:      ppm
-- better:    lower
-- grain:     unit, signal, run, position, temperature, repeat, visit
-- parameters: procedure, repeat, temperature_command, room, position, axis, phase, visit, temperature, forwards, backwards
-- parameters: remark
-- source:    GJB 2426A-2004 5.8.3 (10)(11); JJF 2014-2022 7.2.3 (9)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    given
-- equation:  K_a = |K+ - K-|/((K+ + K-)/2); JJF 2014: over K of the line through all rates
-- influence: rate_nonuniformity: nonuniform
-- of:        internal.scale_fits
-- K+ and K- are slopes of lines with zeros of their own. The rates are the same in both directions, so that what bends
-- both lines alike (v+ = -v-) drops out of the difference and out of its uncertainty.
with sides as (
  select *, slope_difference(plus, minus, -1) as difference,
    case standard when 'GJB2426A' then (plus.k + minus.k) / 2 else k end as reference
  from scale_results('internal.scale_fits') where standard <> 'JJF1536'
), relative as (
  select *, abs(difference.change / reference) * 1e6 as size, difference.u / abs(reference) * 1e6 as u_size,
    student_quantile(0.05, difference.freedom) as wide
  from sides
)
select
  unit, signal, run,
  case when lack is null then size end as value,
  case when u_size is not null then greatest(0, size - wide * u_size) end as lo,
  size + wide * u_size as hi,
  u_size as standard_uncertainty,
  difference.freedom as freedom,
  n,
  struct_insert(words, temperature := round(temperature, 2), forwards := plus.k, backwards := minus.k,
    remark := nullif(concat_ws('; ', remark_on_points, remark_on_drift('the asymmetry', (
        slope_of_drift(plus.points, plus.slope_weights, rest_before, rest_after)
        - slope_of_drift(minus.points, minus.slope_weights, rest_before, rest_after)
      ) / reference * 1e6, u_size, rest_before, rest_after, output_unit)), '')) as parameters,
  [run] as runs, steps, standard,
  case standard when 'GJB2426A' then '5.8.3 (10)(11)' else '7.2.3 (9)' end as clause,
  lack as reason,
  sqrt(list_sum([(z[1] * z[2].rate) ** 2 for z in list_zip(plus.slope_weights, plus.points)])
    + list_sum([(z[1] * z[2].rate) ** 2 for z in list_zip(minus.slope_weights, minus.points)])) as nonuniform
from relative
