-- id:        bias_instability
-- en:        Bias instability
-- zh:        零偏不稳定性
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run
-- parameters: method, duration_s, misfit, markov_correlation_s
-- source:    GJB 2426A-2004 5.12.5.4.2 (25)-(31); JJF 2014-2022 7.2.20 (34)-(39)
-- needs:     a run of one static step whose Allan curve was fitted when it ended (procedure allan_variance)
-- limits:    given
-- equation:  B = sqrt(A_0/(2 ln2/pi)), sigma^2(tau) = sum A_m tau^m
-- Erratum: the print's polynomial by plain least squares gives negative variances; here coefficients are not negative,
-- weighted by the degrees of freedom of the Allan variance, and said to be not observable where the record shows none.
select unit, signal, run, value, lo, hi, standard_uncertainty, null::double as freedom, n,
  {method: 'allan', duration_s: round(duration_s), misfit: misfit, markov_correlation_s: markov_correlation_s}
    as parameters,
  [run] as runs, ["index"] as steps, reason
from internal.noise_coefficients
where coefficient = 'bias_instability'
