-- The points of a scale factor up to each of its rates, from the third one on: with fewer, a line always fits.
create or replace view internal.range_sets as
select * exclude (points, rate_up_to),
  rate_up_to, [p for p in points if abs(p.command) <= rate_up_to] as points
from (
  select run, unit, signal, steps, points, rest_before, rest_after,
    unnest(list_sort(list_distinct(list_concat(forwards, backwards)))[3:]) as rate_up_to
  from internal.scale_sets where nonlinearity_ppm is not null
);
