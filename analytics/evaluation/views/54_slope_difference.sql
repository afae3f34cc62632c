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

-- The mean of several lines, point by point where they have the same rates; else without points, so that
-- `slope_difference` takes their uncertainties.
create or replace macro mean_line(lines) as
  case when lines is null or len(lines) <= 1 then lines[1] else
    list_transform([{
        same: list_bool_and([[round(p.command, 9) for p in each.points] = [round(p.command, 9) for p in lines[1].points]
          for each in lines]),
        places: range(1, len(lines[1].points) + 1)
      }],
      lambda all_: struct_pack(
        k := list_avg([each.k for each in lines]),
        u_k := sqrt(list_sum([each.u_k ** 2 for each in lines])) / len(lines),
        freedom_k := list_sum([each.u_k ** 2 for each in lines]) ** 2
          / nullif(list_sum([each.u_k ** 4 / greatest(each.freedom_k, 1) for each in lines]), 0),
        residuals := [list_avg([each.residuals[i] for each in lines]) for i in all_.places if all_.same],
        slope_weights := lines[1].slope_weights,
        u := [sqrt(list_sum([each.u[i] ** 2 for each in lines])) / len(lines) for i in all_.places if all_.same],
        freedoms := [list_min([each.freedoms[i] for each in lines]) for i in all_.places if all_.same],
        points := if(all_.same, lines[1].points, lines[1].points[1:0]),
        temperature := list_avg([each.temperature for each in lines])))[1]
  end;
