-- Least-squares lines F = K Omega + F0 + v (GJB 2426A-2004 (4)-(6), JJF 2014-2022 (3)-(5), JJF 1536-2015 (13)-(15))
-- through the lists `points` of {rate, output, u, freedom} of any table or view, whose other columns stay as they are.
--
-- A number made of the outputs with the weights w, such as K or F0, has the variance sum(w^2 u^2) with the degrees of
-- freedom of Welch and Satterthwaite; where the points lie off the line by more than their uncertainty, it is
-- sum(w^2) sum(v^2)/(n - 2) with n - 2 degrees of freedom: the larger of the two.
create or replace macro sum_of_products(a, b) as list_sum([z[1] * z[2] for z in list_zip(a, b)]);

create or replace macro weighted_variance(weights, u, freedoms, residuals) as
  list_transform(list_transform(
    [{
      given: case when list_count(u) = len(u) then list_sum([(z[1] * z[2]) ** 2 for z in list_zip(weights, u)]) end,
      fourth: list_sum([(z[1] * z[2]) ** 4 / greatest(z[3], 1) for z in list_zip(weights, u, freedoms)]),
      seen: case when len(residuals) > 2
        then sum_of_products(weights, weights) * sum_of_products(residuals, residuals) / (len(residuals) - 2) end,
      spare: len(residuals) - 2
    }],
    lambda q_: {given: q_.given, nu: case when q_.fourth > 0 then q_.given ** 2 / q_.fourth else 1e9 end, seen: q_.seen,
      spare: q_.spare}),
    lambda q_: case when q_.seen > coalesce(q_.given, 0) then {variance: q_.seen, freedom: q_.spare::double}
      else {variance: q_.given, freedom: q_.nu} end)[1];

-- Standard uncertainties of the residuals: sqrt(sum_k (delta_jk - H_jk)^2 u_k^2), H the hat matrix of the line; null
-- where that of a point is unknown, as of a single sample.
create or replace macro residual_uncertainties(dx, sxx, u) as
  list_transform([{
      n: len(dx), sum_u2: sum_of_products(u, u),
      sum_dx_u2: list_sum([z[1] * z[2] ** 2 for z in list_zip(dx, u)]),
      sum_dx2_u2: list_sum([(z[1] * z[2]) ** 2 for z in list_zip(dx, u)])
    }],
    lambda q_: [
      case when list_count(u) = q_.n then sqrt(greatest(0, z[2] ** 2 * (1 - 2 * (1 / q_.n + z[1] ** 2 / sxx))
        + q_.sum_u2 / q_.n ** 2 + 2 * z[1] * q_.sum_dx_u2 / (q_.n * sxx) + (z[1] / sxx) ** 2 * q_.sum_dx2_u2)) end
      for z in list_zip(dx, u)])[1];

-- The points' uncertainties, taken together where all may be one: a third of the records of white noise are given few
-- degrees of freedom, since they cannot rule out more, and of twenty records one nearly always is. The mean of the
-- variances has the freedom of Welch and Satterthwaite. They are one unless a variance is larger than chance allows at
-- 5 % (chi-squared by Wilson and Hilferty, Bonferroni over the points): noise that grows with the rate stays as it is.
create or replace macro pooled_noise(u, freedoms) as
  list_transform(list_transform([{
      variance: case when list_count(u) = len(u) and list_min(u) > 0 then list_avg([e ** 2 for e in u]) end,
      freedom: list_sum([e ** 2 for e in u]) ** 2
        / nullif(list_sum([z[1] ** 4 / greatest(z[2], 1) for z in list_zip(u, freedoms)]), 0),
      z: -normal_quantile(0.05 / len(u))
    }],
    lambda q_: struct_insert(q_, is_one := coalesce(list_bool_and([z[1] ** 2 <= q_.variance
        * (1 - 2 / (9 * greatest(z[2], 1)) + q_.z * sqrt(2 / (9 * greatest(z[2], 1)))) ** 3
      for z in list_zip(u, freedoms)]), false))),
    lambda q_: case when q_.is_one
      then {u: [sqrt(q_.variance) for e in u], freedoms: [q_.freedom for e in u]} else {u: u, freedoms: freedoms} end)[1];

create or replace macro line_fits(source) as table
with given as (
  select *, [p.rate for p in points] as x, [p.output for p in points] as y, [p.u for p in points] as u,
    [p.freedom for p in points] as freedoms, len(points) as n_points
  from query_table(source)
), means as (
  select *, list_avg(x) as x_mean, list_avg(y) as y_mean from given
), centred as (
  select *, [e - x_mean for e in x] as dx, [e - y_mean for e in y] as dy from means
), spread as (
  select *, sum_of_products(dx, dx) as sxx from centred
), sloped as (
  select *, [e / nullif(sxx, 0) for e in dx] as slope_weights, sum_of_products(dx, dy) / nullif(sxx, 0) as k from spread
), fitted as (
  select *, y_mean - k * x_mean as zero, [z[2] - k * z[1] for z in list_zip(dx, dy)] as residuals,
    [1 / n_points - x_mean * w for w in slope_weights] as zero_weights
  from sloped
)
select *, weighted_variance(slope_weights, u, freedoms, residuals) as k_spread from fitted;
