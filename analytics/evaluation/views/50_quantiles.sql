-- Quantiles for limits that a statement gives itself, as those of the largest of several values. (Parameters of lambdas
-- are called something_ in macros, since the name of a table of the statement would win over them.)

-- Lower quantile of the normal distribution, p below 1/2 (P. J. Acklam's rational approximation, error below 1.2e-9).
create or replace macro normal_quantile(p) as
  case when p < 0.02425 then
    list_reduce([-7.784894002430293e-03, -3.223964580411365e-01, -2.400758277161838, -2.549732539343734,
      4.374664141464968, 2.938163982698783]::double[], lambda a, b: a * sqrt(-2 * ln(p)) + b)
    / list_reduce([7.784695709041462e-03, 3.224671290700398e-01, 2.445134137142996, 3.754408661907416, 1]::double[],
      lambda a, b: a * sqrt(-2 * ln(p)) + b)
  else
    (p - 0.5)
    * list_reduce([-3.969683028665376e+01, 2.209460984245205e+02, -2.759285104469687e+02, 1.383577518672690e+02,
      -3.066479806614716e+01, 2.506628277459239]::double[], lambda a, b: a * (p - 0.5) * (p - 0.5) + b)
    / list_reduce([-5.447609879822406e+01, 1.615858368580409e+02, -1.556989798598866e+02, 6.680131188771972e+01,
      -1.328068155288572e+01, 1]::double[], lambda a, b: a * (p - 0.5) * (p - 0.5) + b)
  end;

-- Student's t that is exceeded in magnitude with probability `tail` (G. W. Hill 1970, CACM algorithm 396: within 5e-6
-- from 3 degrees of freedom, 1 % too wide at 1.5, exact at 1).
create or replace macro student_quantile(tail, freedom) as
  case when freedom <= 1 then 1 / tan(pi() * tail / 2) else
  list_transform(list_transform(list_transform(list_transform(list_transform(
    [{p: tail::double, n: least(freedom, 1e9)::double}],
    lambda k_: struct_insert(k_, a := 1 / (k_.n - 0.5), b := 48 * (k_.n - 0.5) ** 2)),
    lambda k_: struct_insert(k_, c := ((20700 * k_.a / k_.b - 98) * k_.a - 16) * k_.a + 96.36)),
    lambda k_: struct_insert(k_, d := ((94.5 / (k_.b + k_.c) - 3) / k_.b + 1) * sqrt(k_.a * pi() / 2) * k_.n)),
    lambda k_: struct_insert(k_, x := normal_quantile(k_.p / 2), y := (k_.d * k_.p) ** (2 / k_.n))),
    lambda k_: sqrt(k_.n * case when k_.y > 0.05 + k_.a
      then student_near(k_.n, k_.a, k_.b, k_.c, k_.d, k_.x) else student_far(k_.n, k_.d, k_.y) end))[1]
  end;

create or replace macro student_near(n, a, b, c, d, x) as
  list_transform(list_transform(
    [{x: x, y: x * x, c: c + case when n < 5 then 0.3 * (n - 4.5) * (x + 0.6) else 0 end}],
    lambda n_: {x: n_.x, y: n_.y, c: (((0.05 * d * n_.x - 5) * n_.x - 7) * n_.x - 2) * n_.x + b + n_.c}),
    lambda n_:
      exp(a * ((((((0.4 * n_.y + 6.3) * n_.y + 36) * n_.y + 94.5) / n_.c - n_.y - 3) / b + 1) * n_.x) ** 2) - 1)[1];

create or replace macro student_far(n, d, y) as
  ((1 / (((n + 6) / (n * y) - 0.089 * d - 0.822) * (n + 2) * 3) + 0.5 / (n + 4)) * y - 1) * (n + 1) / (n + 2) + 1 / y;
