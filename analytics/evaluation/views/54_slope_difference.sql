-- What two scale factors differ by, with its uncertainty: two structs {k, u_k, freedom_k, residuals, slope_weights, u,
-- freedoms, points} of lines. Where both were measured at the same rates, the points' scatter about both lines counts
-- only as far as it differs: a nonlinearity that both have in common moves both alike. `mirror` is -1 where the rates
-- of one are the negative ones of the other.
create or replace macro slope_difference(a, b, mirror) as
  list_transform([
    {
      change: a.k - b.k,
      paired: [round(p.command, 9) for p in a.points] = [round(p.command * mirror, 9) for p in b.points],
      of_both: a.u_k ** 2 + b.u_k ** 2,
      freedom_of_both: (a.u_k ** 2 + b.u_k ** 2) ** 2 / (a.u_k ** 4 / a.freedom_k + b.u_k ** 4 / b.freedom_k)
    }],
    lambda both_: case when not both_.paired
      then {change: both_.change, u: sqrt(both_.of_both), freedom: both_.freedom_of_both}
      else list_transform([
        weighted_variance(
          a.slope_weights, [sqrt(z[1] ** 2 + z[2] ** 2) for z in list_zip(a.u, b.u)],
          [welch_freedom(z[1], z[2], z[3], z[4]) for z in list_zip(a.u, a.freedoms, b.u, b.freedoms)],
          [z[1] - mirror * z[2] for z in list_zip(a.residuals, b.residuals)]
        )],
        lambda joint_: {change: both_.change, u: sqrt(joint_.variance), freedom: joint_.freedom})[1] end)[1];

-- Degrees of freedom of a sum of two by Welch and Satterthwaite (JCGM 100:2008 G.4.1).
create or replace macro welch_freedom(u_a, freedom_a, u_b, freedom_b) as
  case when u_a > 0 or u_b > 0
    then (u_a ** 2 + u_b ** 2) ** 2 / (u_a ** 4 / greatest(freedom_a, 1) + u_b ** 4 / greatest(freedom_b, 1))
    else 1e9 end;
