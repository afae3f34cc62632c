-- id:        scale_factor_temperature_sensitivity
-- en:        Scale-factor temperature sensitivity
-- zh:        标度因数温度灵敏度
-- unit:      ppm/degC
-- better:    lower
-- grain:     unit, signal, run
-- parameters: procedure, position, axis, repeat, points, temperature_of_maximum, room_temperature, remark
-- source:    GJB 2426A-2004 5.8.5 (13); JJF 2014-2022 7.2.5 (11)
-- needs:     scale factors at room temperature and at other temperatures
-- limits:    given
-- equation:  K_t = max|(K_i - K_m)/(K_m (T_i - T_m))|
-- influence: temperature: value * sqrt(2) / nullif(abs((parameters->>'$.temperature_of_maximum')::double - (parameters->>'$.room_temperature')::double), 0)
-- of:        internal.scale_fits
-- Erratum: GJB (13) prints max under the quotient only; meant is the largest quotient. Room temperature is what says
-- so, else the one set nearest to 20 degC, at most 10 degC from it; visited more than once, K_m is the mean. Any other
-- visit is a point of its own; points nearer to the room's temperature than 1 degC are none. A
-- maximum of noisy values is too large by nature: its limits are those that hold for all points together (Bonferroni),
-- the largest of the lower and the largest of the upper ones.
with forced as (
  select *, coalesce(temperature_command, temperature) as set_to
  from scale_results('internal.scale_fits') where standard <> 'JJF1536' and phase is null
), begun as (
  select *, begins_class(set_to, run, unit, signal, "procedure", repeat) as begins from forced
), classed as (
  select *, class_of(begins, set_to, run, unit, signal, "procedure", repeat) as warmth from begun
), judged_visits as (
  -- a visit without a scale factor counts for nothing where another one to the same temperature has one
  select *, visit is not null and lack is not null and count(*) filter (lack is null) over (
    partition by run, unit, signal, "procedure", position, axis, repeat, standard, warmth) > 0 as is_left_out
  from classed
), tested as (
  select *,
    count(*) filter (is_left_out) over test as left_out,
    count(distinct coalesce(temperature_command, 1e9)) over test as temperatures,
    max(temperature) over test - min(temperature) over test as spread,
    bool_or(room) over test as says_room,
    min(abs(set_to - 20)) over test as nearest,
    -- of two that are as near, the one that was measured first
    arg_min(set_to, (abs(set_to - 20), steps)) over test as room_set_to
  from judged_visits
  window test as (partition by run, unit, signal, "procedure", position, axis, repeat, standard)
), marked as (
  select *, case when says_room then room
    else coalesce(abs(set_to - room_set_to) <= if(temperature_command is null, 5, 1) and nearest <= 10, false) end
      as is_room
  from tested
  where not is_left_out
    and (regexp_matches("procedure", '^scale_factor_temperature') or ((temperatures > 1 or spread > 5)
    and not regexp_matches(coalesce("procedure", ''), '^(scale_factor_(acc|shock|vib)|threshold|resolution)')))
), collected as (
  select run, unit, signal, "procedure", position, axis, repeat, standard, k_unit,
    list({k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, slope_weights: slope_weights, u: u,
      freedoms: freedoms, points: points, temperature: temperature} order by steps) filter (not is_room) as others,
    list({k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, slope_weights: slope_weights, u: u,
      freedoms: freedoms, points: points, temperature: temperature} order by steps) filter (is_room) as rooms,
    list(coalesce(format('{:.1f} degC: ', temperature), '') || lack order by steps) filter (lack is not null) as lacks,
    nullif(concat_ws('; ', case when min(left_out) > 0 then
      min(left_out) || ' visits to a temperature have no scale factor, and are left out' end,
      remark_on_ranges(list(remark_on_range))), '') as remark,
    min(nearest) as nearest, flatten(list(steps order by steps)) as steps, sum(n)::bigint as n
  from marked group by all
), compared as (
  select * exclude (others),
    [struct_insert(slope_difference(p, room, 1), apart := p.temperature - room.temperature, at := p.temperature)
      for p in others if abs(p.temperature - room.temperature) >= 1] as changes
  from (select *, mean_line(rooms) as room from collected)
), quotients as (
  select *, [{
      size: abs(c.change / (room.k * c.apart)) * 1e6, u: abs(c.u / (room.k * c.apart)) * 1e6, freedom: c.freedom,
      temperature: c.at,
      wide: student_quantile(0.05 / len(changes), c.freedom)
    } for c in changes] as points
  from compared
), judged as (
  select *, list_sort(points, 'desc')[1] as worst,
    case
      when len(lacks) > 0 then array_to_string(lacks, '; ')
      when rooms is null then
        'the room-temperature point is missing: nothing is marked room, and the nearest to 20 degC'
        || coalesce(format(' is {:.1f} degC from it, at most 10 are allowed', nearest), ' is unknown')
      when room.temperature is null then
        'the temperature at room temperature is unknown: record one, or say temperature_command'
      when coalesce(len(points), 0) = 0 then
        'no other temperature than that of the room was measured: the clauses ask for points over the range of use'
    end as lack
  from quotients
)
select
  unit, signal, run,
  case when lack is null then worst.size end as value,
  list_max([greatest(0, p.size - p.wide * p.u) for p in points]) as lo,
  list_max([p.size + p.wide * p.u for p in points]) as hi,
  worst.u as standard_uncertainty,
  worst.freedom as freedom,
  n,
  {"procedure": "procedure", position: position, axis: axis, repeat: repeat, points: len(points),
    temperature_of_maximum: round(worst.temperature, 2), room_temperature: round(room.temperature, 2),
    remark: remark} as parameters,
  [run] as runs, list_sort(steps) as steps, standard,
  case standard when 'GJB2426A' then '5.8.5 (13)' else '7.2.5 (11)' end as clause,
  lack as reason
from judged
