-- One row for each scale factor that was measured: the points of its rates, the rests around them, what is asked of
-- them by each standard, and the least-squares lines through all points, the forward ones and the backward ones.
-- Planning the lines takes longer than computing them: the table scale_fits has them.

-- Rates within a thousandth are one: a column of commands may hold what was measured.
create or replace macro sorted_distinct_rates(sorted) as
  list_filter(sorted, lambda r, i: i = 1 or r > sorted[i - 1] * 1.001);

create or replace macro distinct_rates(rates) as sorted_distinct_rates(list_sort(rates));

create or replace macro rates_without(rates, others) as
  list_filter(rates, lambda r: not coalesce(list_bool_or([abs(o - r) <= r * 0.001 for o in others]), false));

-- A temperature that was visited twice gives two scale factors: `visit` counts them, null where there is one. Without
-- commanded temperatures a step of more than 5 degC between two steps begins a stay. Stays are visits where each has 60 %
-- of the rates at least, without commands where two have: what was shared among them, as forwards now and backwards
-- later, is one scale factor. Rests belong to the stay with rates before them.
create or replace view internal.visited_rate_points as
with moved as (
  select *, coalesce(temperature_command <> lag(temperature_command) over steps
      or temperature_command is null and abs(temperature - lag(temperature) over steps) > 5, false) as moves
  from internal.rate_points
  window steps as (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit
    order by "index")
), stayed as (
  select *, sum(moves::int) over (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit
    order by "index" rows unbounded preceding) as stay
  from moved
), rated as (
  select *,
    count(distinct rate_command) filter (not at_rest)
      over (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit, stay) as stay_rates,
    count(distinct rate_command) filter (not at_rest) over alike as all_rates
  from stayed
  window alike as (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit,
    temperature_command, room)
), owned as (
  select *,
    coalesce(
      last_value(case when stay_rates > 0 then stay end ignore nulls) over (partition by run, unit, signal, "procedure",
        repeat, position, axis, phase, output_unit, temperature_command, room order by "index" rows unbounded preceding),
      first_value(case when stay_rates > 0 then stay end ignore nulls) over (partition by run, unit, signal, "procedure",
        repeat, position, axis, phase, output_unit, temperature_command, room order by "index"
        rows between current row and unbounded following)) as own_stay,
    stay_rates >= 0.6 * all_rates as is_whole
  from rated
), counted as (
  select *,
    count(distinct own_stay) over alike as stays,
    count(distinct case when is_whole then own_stay end) over alike as whole_stays,
    dense_rank() over (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit,
      temperature_command, room order by own_stay) as number
  from owned
  window alike as (partition by run, unit, signal, "procedure", repeat, position, axis, phase, output_unit,
    temperature_command, room)
)
select * exclude (moves, stay, stay_rates, all_rates, own_stay, is_whole, stays, whole_stays, number),
  case when stays > 1 and (whole_stays = stays or temperature_command is null and whole_stays > 1) then number end as visit
from counted;

create or replace view internal.scale_sets as
with measured as (
  select
    run, unit, signal, "procedure", repeat, temperature_command, room, position, axis, phase, visit, output_unit,
    min(product) as product, min(station) as station, min(time_zone) as time_zone, bool_and(date_known) as date_known,
    min(t_from_ns) as t_from_ns, max(t_to_ns) as t_to_ns,
    coalesce(list({
      "index": "index", command: rate_command, rate: input_rate, output: output, u: u, freedom: coalesce(freedom, 1),
      temperature: temperature, stands_still: stands_still,
      -- from the first sample to the one after the last
      lasts_s: duration_s * n / greatest(n - 1, 1)
    } order by "index") filter (not at_rest), []) as points,
    list({"index": "index", output: output, u: u, freedom: coalesce(freedom, 1)} order by "index")
      filter (at_rest) as rests,
    sum(n)::bigint as n
  from internal.visited_rate_points
  group by all
), counted as (
  select *,
    distinct_rates([p.command for p in points if p.command > 0]) as forwards,
    distinct_rates([-p.command for p in points if p.command < 0]) as backwards,
    [r for r in rests if r."index" < points[1]."index"][-1] as rest_before,
    [r for r in rests if r."index" > points[-1]."index"][1] as rest_after
  from measured
)
select c.*,
  list_max(list_concat(forwards, backwards)) as largest_rate,
  list_avg([p.temperature for p in points]) as temperature,
  list_sort([p."index" for p in list_concat(
    [{"index": p."index"} for p in points], [{"index": r."index"} for r in [rest_before, rest_after] if r is not null]
  )]) as steps,
  p.max_rate_deg_per_s, p.nonlinearity_ppm
from counted c left join internal.run_products p on p.unit = c.unit and p.run = c.run
-- with fewer rates, in a procedure of another name, it is some other test
where is_scale_factor_procedure("procedure") or len(forwards) + len(backwards) > 2;

create or replace view internal.scale_sides as
select * exclude (points),
  case side when 'both' then points when 'forwards' then [p for p in points if p.command > 0]
    else [p for p in points if p.command < 0] end as points
from (select *, unnest(['both', 'forwards', 'backwards']) as side from internal.scale_sets);

create or replace macro listed(rates) as  -- the first of them, and how many there are
  array_to_string([format('{:g}', r) for r in rates[:12]], ', ') || if(len(rates) > 12, ', ... (' || len(rates) || ')', '');

create or replace macro lack_of_directions(forwards, backwards, clause) as
  nullif(concat_ws('; ',
    case when least(len(forwards), len(backwards)) < 11 then
      len(forwards) || ' rates measured forwards and ' || len(backwards)
      || ' backwards, 11 in each direction are asked for (' || clause || ')' end,
    case when len(rates_without(forwards, backwards)) + len(rates_without(backwards, forwards)) > 0 then
      'the rates are not symmetric: '
      || concat_ws(' and ',
        nullif(listed(rates_without(forwards, backwards)), '') || ' deg/s forwards only',
        nullif(listed(rates_without(backwards, forwards)), '') || ' deg/s backwards only')
      || '; measure each rate in both directions (' || clause || ')' end
  ), '');

create or replace macro lack_of_answer(points, k, u_k, freedom_k) as
  case when len(points) > 1 and list_min([p.output for p in points]) = list_max([p.output for p in points]) then
    format('the output is {:g} at every rate: the axis does not answer', points[1].output)
    when isfinite(u_k) and abs(k) <= student_quantile(0.025, greatest(freedom_k, 1)) * u_k then
      format('the output does not depend on the rate: K is {:.3g} with a standard uncertainty of {:.3g}, and may be 0', k, u_k)
  end;

create or replace macro remark_on_points(points, remark_on_range) as
  nullif(concat_ws('; ', remark_on_range, case when list_bool_or([p.stands_still for p in points]) then
    'the output stands still at ' || len([p for p in points if p.stands_still]) || ' of ' || len(points) || ' rates'
    || if(still_at_largest(points), ', the largest ones: it is clipped at an end of its range, or frozen',
      ': it is frozen, or its resolution too coarse to show noise') end,
    -- the zero and K follow the temperature: where it follows the rate, the line takes it in without a residual
    case when list_max([p.temperature for p in points]) - list_min([p.temperature for p in points]) > 2 then
      format('the temperature moved by {:.1f} degC from rate to rate: what it does to the output is in the value, and the interval '
        'need not show it', list_max([p.temperature for p in points]) - list_min([p.temperature for p in points])) end), '');

-- The output of a zero that moves as steadily from step to step as the rests before and after say, at each rate: what it
-- does to a metric depends on the order of the rates.
create or replace macro drift_at(points, rest_before, rest_after) as
  [(rest_after.output - rest_before.output) * (p."index" - rest_before."index") / (rest_after."index" - rest_before."index")
    for p in points];

create or replace macro slope_of_drift(points, slope_weights, rest_before, rest_after) as
  list_sum([z[1] * z[2] for z in list_zip(slope_weights, drift_at(points, rest_before, rest_after))]);

-- Named where the rests differ by more than three standard uncertainties, and the metric by more than half of one.
create or replace macro remark_on_drift(what, ppm, u_ppm, rest_before, rest_after, output_unit) as
  case when abs(rest_after.output - rest_before.output) > 3 * sqrt(rest_after.u ** 2 + rest_before.u ** 2)
      and abs(ppm) > 0.5 * coalesce(u_ppm, 0) then
    format('the output at rest moved by {:.3g} {} through the rates: a steady drift changes {} by {:.2g} ppm in this order of '
      || 'rates, which the interval does not hold; measure the rates again in the reverse order',
      rest_after.output - rest_before.output, output_unit, what, ppm) end;

create or replace macro lack_of_seconds(points, asked, clause) as
  case when list_min([p.lasts_s for p in points]) < asked * (1 - 1e-3) then
    format('{:g} s recorded at {} deg/s, at least {:g} s at each rate are asked for ({})',
      round(list_min([p.lasts_s for p in points]), 1), listed([p.command for p in points if p.lasts_s < asked * (1 - 1e-3)]),
      asked, clause) end;

create or replace macro lack_of_range(largest, asked, product) as
  case when largest < asked * (1 - 1e-3) then
    format('the largest rate is {:g} deg/s, that of product {} is {:g} deg/s and must be among them', largest, product,
      asked)
  end;

create or replace macro scale_lines(source) as table
with sided as (
  select * exclude (k_spread), sqrt(k_spread.variance) as u_k, k_spread.freedom as freedom_k
  from line_fits(source)
), other as (
  select run, unit, signal, steps,
    any_value({k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, sxx: sxx, n_points: n_points, points: points,
      slope_weights: slope_weights, u: u, freedoms: freedoms})
      filter (side = 'forwards') as plus,
    any_value({k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, sxx: sxx, n_points: n_points, points: points,
      slope_weights: slope_weights, u: u, freedoms: freedoms})
      filter (side = 'backwards') as minus
  from sided where side <> 'both' group by all
), lacks as (
  select s.* exclude (side), o.plus, o.minus,
    (s.rest_before.output + s.rest_after.output) / 2 as rest_zero,
    case when output_unit = 'deg/s' then '1' when ends_with(output_unit, '/s') then output_unit[:-3] || '/deg'
      else output_unit || '/(deg/s)' end as k_unit,
    lack_of_answer(points, k, u_k, freedom_k) as lack_of_answer,
    remark_on_short(e.commands, e.most) as remark_on_range,
    remark_on_points(points, remark_on_range) as remark_on_points,
    lack_of_directions(forwards, backwards, '5.8.1.3') as gjb_directions,
    lack_of_directions(forwards, backwards, '7.2.1.1 b') as jjf_directions,
    lack_of_range(largest_rate, max_rate_deg_per_s, product) as lack_of_range,
    case
      when rest_before is null and rest_after is null then
        'no record of the table at rest before and after the rates (5.8.1.3 d)'
      when rest_before is null then 'no record of the table at rest before the rates (5.8.1.3 d)'
      when rest_after is null then 'no record of the table at rest after the rates (5.8.1.3 d)'
    end as lack_of_rest,
    concat_ws('; ', case when len(forwards) + len(backwards) < 7 then
      len(forwards) + len(backwards) || ' rates measured, 7 to 11 are asked for (7.1.1 c)' end,
      lack_of_seconds(points, 20.0, '7.1.1 d')) as jjf1536_lack,
    -- more rates than the clause has do no harm, and are no longer its method
    case when len(forwards) + len(backwards) > 11 then
      len(forwards) + len(backwards) || ' rates: the clause has 7 to 11 (7.1.1 c)' end as jjf1536_remark
  from sided s left join other o using (run, unit, signal, steps)
    left join range_ends(source) e using (run, unit, signal, steps)
  where s.side = 'both'
)
select *,
  nullif(concat_ws('; ', lack_of_answer, gjb_directions, lack_of_range, lack_of_rest), '') as gjb_reason,
  nullif(concat_ws('; ', lack_of_answer, jjf_directions, lack_of_range), '') as jjf_reason,
  nullif(concat_ws('; ', lack_of_answer, nullif(jjf1536_lack, ''), replace(lack_of_rest, '5.8.1.3 d', '(11)')), '')
    as jjf1536_reason,
  {
    "procedure": "procedure", repeat: repeat, temperature_command: temperature_command, room: room, position: position,
    axis: axis, phase: phase, visit: visit
  } as words
from lacks;

create or replace table internal.scale_fits as from scale_lines('internal.scale_sides');

-- The scale factor of each standard that the measurement can serve, with the reason where something it asks for is
-- missing.
create or replace macro scale_results(source) as table
select * exclude (form), form.standard as standard, form.reason as lack
from (
  select *, unnest(list_filter([
    {standard: 'GJB2426A', reason: gjb_reason,
      applies: not regexp_matches(coalesce("procedure", ''),
        '^(attitude_unit|rates_jjf|scale_factor_(jjf|acc|shock|vib))')},
    {standard: 'JJF2014', reason: jjf_reason, applies: not starts_with(coalesce("procedure", ''), 'attitude_unit')},
    {standard: 'JJF1536', reason: jjf1536_reason, applies: starts_with(coalesce("procedure", ''), 'attitude_unit')
      or (not starts_with(coalesce("procedure", ''), 'scale_factor')
        and len(forwards) + len(backwards) between 7 and 11)}
  ], lambda f: f.applies)) as form
  from query_table(source)
);
