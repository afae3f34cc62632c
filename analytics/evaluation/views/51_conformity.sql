-- Distribution functions for the probability of conformity (JCGM 106:2012 7).

-- Of the normal distribution (Abramowitz and Stegun 26.2.17, error below 7.5e-8).
create or replace macro normal_tail(z) as
  exp(-z * z / 2) / sqrt(2 * pi()) * list_reduce(
    [1.330274429, -1.821255978, 1.781477937, -0.356563782, 0.319381530, 0.0]::double[],
    lambda a, b: a / (1 + 0.2316419 * z) + b);

create or replace macro normal_cdf(z) as
  case when z < 0 then normal_tail(-z) else 1 - normal_tail(z) end;

-- Of Student's t (Wallace 1959, doi:10.1214/aoms/1177706068: within 0.003 from 1.5 degrees of freedom, 0.0003 from 5).
-- As the argument of the normal distribution: a macro is planned with as many copies of an argument as it names it.
create or replace macro student_as_normal(t, freedom) as
  sign(t) * (8 * least(freedom, 1e9) + 1) / (8 * least(freedom, 1e9) + 3)
    * sqrt(least(freedom, 1e9) * ln(1 + t * t / least(freedom, 1e9)));

-- U as it is printed: rounded up to two digits, but for what is immaterial (JCGM 100 7.2.6, as `round_up` in Python).
create or replace macro stated_uncertainty(u) as
  case when u > 0 and isfinite(u) then list_transform([{place: floor(log10(u))::int - 1}],
    lambda q_: (if(u / pow(10.0, q_.place) - round(u / pow(10.0, q_.place)) between 0 and u / pow(10.0, q_.place) * 0.002,
      round(u / pow(10.0, q_.place)), ceil(u / pow(10.0, q_.place) - 1e-9))::bigint || 'e' || q_.place)::double)[1]
  else u end;
