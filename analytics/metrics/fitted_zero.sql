-- id:        fitted_zero
-- en:        Fitted zero
-- zh:        拟合零位
-- unit:      deg/h
-- better:    neither
-- grain:     unit, signal, run, position, temperature, repeat
-- source:    GJB 2426A-2004 5.8.1 (6); JJF 2014-2022 7.2.1 (5); JJF 1536-2015 7.1 (15)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    t
-- equation:  F0 = mean(F_j) - K mean(Omega_j), reported as F0/K
-- JJF 2014 subtracts no rest, so its F0 is the bias; of GJB and JJF 1536, which subtract F_r = (F_s + F_e)/2, it is
-- what is left. F0/K is a weighted sum of the outputs but for its own small change with K: weights (d_j - c_j F0/K)/K.
with zeros as (
  select *, standard <> 'JJF2014' as subtracts,
    (zero - case when subtracts then rest_zero else 0 end) / k as rate_at_zero
  from scale_results('scale_fits')
), listed as (                          -- the rests are outputs like the others, with half the weight of a mean of one
  select *,
    [(z[1] - z[2] * rate_at_zero) / k for z in list_zip(zero_weights, slope_weights)] as weights_of_line,
    case when subtracts then [r for r in [rest_before, rest_after] if r is not null] else [] end as taken_off
  from zeros
), weighed as (
  select *,
    weighted_variance(
      list_concat(weights_of_line, [-1 / (2 * k) for r in taken_off]), list_concat(u, [r.u for r in taken_off]),
      list_concat(freedoms, [r.freedom for r in taken_off]), residuals
    ) as spread
  from listed
)
select
  unit, signal, run,
  case when lack is null then rate_at_zero * 3600 end as value,
  sqrt(spread.variance) * 3600 as standard_uncertainty,
  spread.freedom as freedom,
  n,
  struct_insert(words, temperature := round(temperature, 2), output := rate_at_zero * k, output_unit := output_unit)
    as parameters,
  [run] as runs, steps, standard,
  case standard when 'GJB2426A' then '5.8.1 (6)' when 'JJF2014' then '7.2.1 (5)' else '7.1 (15)' end as clause,
  lack as reason
from weighed
