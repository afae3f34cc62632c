-- id:        scale_factor_acceleration_sensitivity
-- en:        Scale-factor sensitivity to axial acceleration
-- zh:        标度因数轴向加速度敏感度
-- unit:      1/g
-- better:    nearer_zero
-- grain:     unit, signal, run, repeat, temperature
-- parameters: procedure, repeat, temperature_command, up, down, ppm_per_g, remark
-- source:    JJF 2014-2022 7.2.6
-- needs:     scale factors with the input reference axis up and down, at least 11 rates in each direction
-- limits:    t
-- equation:  (K(IRA up) - K(IRA down))/2 g
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- of:        internal.scale_fits
-- The clause compares magnitudes: where the rate is counted about the table's axis, which the IRA points against when
-- it is down, that scale factor has the other sign.
with forced as (
  select *,
    temperature_in_force(temperature_command, temperature, run, unit, signal, "procedure", repeat, steps[1]) as in_force
  from scale_results('internal.scale_fits')
  where standard = 'JJF2014' and phase is null
    and (regexp_matches(position, '^(IRA|vertical)_(up|down)$')
      or starts_with("procedure", 'scale_factor_acceleration'))
), begun as (
  select *, begins_class(in_force, run, unit, signal, "procedure", repeat) as begins from forced
), placed as (
  select *, regexp_extract(position, '_(up|down)$', 1) as pointing,
    {k: k, u_k: u_k, freedom_k: freedom_k, residuals: residuals, slope_weights: slope_weights, u: u,
      freedoms: freedoms, points: points, temperature: temperature} as line,
    class_of(begins, in_force, run, unit, signal, "procedure", repeat) as warmth
  from begun
), paired as (
  select run, unit, signal, "procedure", repeat, k_unit, warmth,
    round(avg(temperature_command), 1) as temperature_command,
    mean_line(list(line order by steps) filter (pointing = 'up')) as up,
    mean_line(list(line order by steps) filter (pointing = 'down')) as down,
    list(coalesce(position || ': ', '') || lack order by steps) filter (lack is not null) as lacks,
    flatten(list(steps order by steps)) as steps, sum(n)::bigint as n,
    bool_or(starts_with("procedure", 'scale_factor_acceleration')) as is_asked,
    remark_on_ranges(list(remark_on_range)) as ranges
  from placed group by all
), turned as (
  select *, slope_difference(up, struct_pack(k := down.k * sign(up.k * down.k), u_k := down.u_k,
      freedom_k := down.freedom_k, residuals := [r * sign(up.k * down.k) for r in down.residuals],
      slope_weights := down.slope_weights, u := down.u, freedoms := down.freedoms, points := down.points,
      temperature := down.temperature), 1) as difference,
    nullif(concat_ws('; ', remark_on_temperatures(up, down, 'up', 'down'), ranges), '') as remark,
    case
      when up is null then 'not measured with the IRA up: the clause asks for up and down (7.2.6.1 c)'
      when down is null then 'not measured with the IRA down: the clause asks for up and down (7.2.6.1 c)'
      when len(lacks) > 0 then array_to_string(lacks, '; ')
    end as lack
  from paired where is_asked or (up is not null and down is not null)
)
select
  unit, signal, run,
  case when lack is null then difference.change / 2 end as value,
  k_unit || '/g' as unit_of_measure,
  difference.u / 2 as standard_uncertainty,
  difference.freedom as freedom,
  n,
  {"procedure": "procedure", repeat: repeat, temperature_command: temperature_command, remark: remark, up: up.k, down: down.k, ppm_per_g: difference.change / 2 / up.k * 1e6}
    as parameters,
  [run] as runs, list_sort(steps) as steps,
  lack as reason
from turned
