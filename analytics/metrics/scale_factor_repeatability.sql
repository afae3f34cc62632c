-- id:        scale_factor_repeatability
-- en:        Scale-factor repeatability
-- zh:        标度因数重复性
-- unit:      ppm
-- better:    lower
-- grain:     unit, signal, run (or all runs of the unit, then no run is named), kind
-- parameters: kind, scale_factors, mean, days, uncertainty_of_means, beyond_uncertainty, remark
-- source:    GJB 2426A-2004 5.8.4 (12); JJF 2014-2022 7.2.4 (10)
-- needs:     Q scale factors, the unit off and cooled in between; GJB: Q >= 6
-- limits:    given
-- equation:  K_r = sqrt(sum((K_i - mean(K))^2)/(Q - 1))/mean(K)
-- influence: rate: per_ppm(value)
-- python:    analytics.metrics.scale_factor_repeatability:compute
-- of:        internal.scale_fits
-- A run is a test by itself if its procedure is one or it holds several scale factors; all runs of a unit together are
-- another. Left out are those that were measured under several conditions on purpose, and rates of other procedures that
-- make no scale factor, where the unit has scale factors.
with conditioned as (
  select *,
    count(distinct coalesce(temperature_command, 1e9)) over test as temperatures,
    count(distinct coalesce(position, '')) over test as positions,
    count(distinct coalesce(visit, 0)) over test as visits,
    -- of the means at the rates, without what is the same in every scale factor, as nonlinearity
    [(z[1] * z[2]) ** 2 for z in list_zip(slope_weights, u)] as parts,
    case when date_known then strftime(timezone(time_zone, make_timestamptz(t_from_ns // 1000)), '%Y-%m-%d') end as day
  from scale_results('internal.scale_fits')
  where standard <> 'JJF1536' and phase is null and n_points > 0
    and (axis is null or axis_word_of(axis) = named_axis_of(signal))
    and not regexp_matches(coalesce("procedure", ''), '^(scale_factor_(temp|acc|shock|vib)|threshold|resolution)')
  window test as (partition by run, unit, signal, "procedure", standard),
    unit_s as (partition by unit, signal, output_unit, standard)
  qualify lack is null or is_scale_factor_procedure("procedure")
    or not bool_or(lack is null or is_scale_factor_procedure("procedure")) over unit_s
), counted as (
  select *,
    list_sum(parts) as variance,
    list_sum(parts) ** 2 / list_sum([z[1] ** 2 / z[2] for z in list_zip(parts, freedoms)]) as freedom,
    count(*) filter (lack is null) over own as in_run,
    bool_or(starts_with("procedure", 'scale_factor_repeatability')) over own as is_test
  from conditioned where temperatures = 1 and positions = 1 and visits = 1
  window own as (partition by unit, signal, output_unit, standard, run)
), scoped as (
  select *, run as scope from counted where is_test or in_run > 1
  union all
  select *, null as scope from counted
)
select unit, signal, scope as run, standard, if(standard = 'GJB2426A', '5.8.4 (12)', '7.2.4 (10)') as clause,
  list(k order by t_from_ns, run, steps) filter (lack is null) as scales,
  list(case when len(list_filter(parts, lambda p: p is null)) = 0 then sqrt(variance) end order by t_from_ns, run, steps)
    filter (lack is null) as uncertainties,
  list(freedom order by t_from_ns, run, steps) filter (lack is null) as freedoms,
  list(coalesce(day, 'run ' || run) order by t_from_ns, run, steps) filter (lack is null) as days,
  bool_and(day is not null) as is_dated,
  nullif(concat_ws('; ', stations_remark(list(station) filter (lack is null)),
    remark_on_ranges(list(remark_on_range) filter (lack is null))), '') as remark,
  list(distinct run order by run) as runs,
  flatten(list(steps order by run, t_from_ns, steps)) as steps,
  min('run ' || run || ': ' || lack) as lack
from scoped
group by unit, signal, output_unit, scope, standard
having scope is not null or count(distinct run) > 1
order by unit, signal, output_unit, scope, standard
