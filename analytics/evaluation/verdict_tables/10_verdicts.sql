-- Verdicts: each value against the limits of the specification that was valid when its last run began, as that was known
-- when the run was recorded; what a specification asks for and nobody has measured; and checks that were entered by hand.
create or replace macro verdict_rank(verdict) as
  case verdict when 'FAIL' then 1 when 'MARGINAL' then 2 when 'NO_DATA' then 3 when 'PASS' then 4 end;
create or replace macro verdict_of_rank(rank) as
  case rank when 1 then 'FAIL' when 2 then 'MARGINAL' when 3 then 'NO_DATA' when 4 then 'PASS' end;

-- Planned once, for the tables below.
create or replace table internal.tested_runs as from unit_runs;

-- The last run of each unit; its product from the last run that knew it.
create or replace table internal.unit_last_run as
select u.* replace (coalesce(u.product, p.product) as product)
from internal.tested_runs u
left join (select unit, arg_max(product, t_start_ns) as product from internal.tested_runs where product is not null group by unit) p
  on p.unit = u.unit
qualify row_number() over (partition by u.unit order by u.date_known desc, u.t_start_ns desc, u.run) = 1;

-- Every unit that was tested, mounted or checked, with the moment and place that decide what is asked of it: those of its
-- last run with a completed step; without one, those of its last run, else of the last check that was entered. `lack`
-- says why such a run has no values.
create or replace table internal.judged_units as
with mounting as materialized (
  from units
), entered as (
  select unit, max(t_ns) as t_ns, min(arrival_ns) as recorded_ns
  from internal.standing_checks group by unit
), idle as (                            -- runs without a completed record of a unit that they name, not excluded
  select u.unit, u.run, u.product, u.lot, u.station, u.fixture, u.mounted is not null as date_known, u.t_ns,
    cast(make_timestamp_ns(u.t_ns) as date) as day,
    if(c.unit is null, 'no sample of it came', 'no step of its runs was completed') as lack
  from mounting u
  left join (select distinct unit, run from internal.lake_channels) c using (unit, run)
  anti join exclusions x on x.unit = u.unit and x.run = u.run
  anti join internal.unit_last_run l on l.unit = u.unit
  where u.mountings > 0
  qualify row_number() over (partition by u.unit order by date_known desc, u.t_ns desc, u.run) = 1
), mounted as (
  select unit, arg_max(product, t_ns) as product, arg_max(lot, t_ns) as lot from mounting group by unit
)
select unit, run, product, lot, station, fixture, day, date_known, t_start_ns as t_ns, null::bigint as recorded_ns,
  null::varchar as lack
from internal.unit_last_run
union all
select unit, run, product, lot, station, fixture, day, date_known, t_ns, null, lack from idle
union all
select e.unit, '', m.product, m.lot, null, null, cast(make_timestamp_ns(e.t_ns) as date), true, e.t_ns, e.recorded_ns,
  null
from entered e left join mounted m using (unit) anti join internal.unit_last_run l on l.unit = e.unit
anti join idle i on i.unit = e.unit;

-- At which moment it is looked up what was known of the specifications: when the run was recorded, so that what is
-- entered later changes no verdict. Where no limit applied by what was known then, it is for each specification the first
-- moment after it when one of its limits did (`first_known`), so that all that nothing judged before are judged, in
-- whatever order they are entered; `known_ns` is the first of these. Where none ever did, or nothing tells when a run
-- was recorded, everything is known. A document that rejudges counts as if all before it were recorded then.
create or replace table internal.run_known as
with placed as (
  select u.unit, u.run, coalesce(u.product, l.product) as product, u.date_known, u.t_start_ns as t_ns,
    null::bigint as recorded_ns
  from internal.tested_runs u join internal.unit_last_run l on l.unit = u.unit
  union all
  select unit, run, product, date_known, t_ns, recorded_ns from internal.judged_units where run = '' or lack is not null
), recorded as (
  select unit, run, min(arrival_first_ns) as recorded_ns from internal.lake_channels group by unit, run
), moment as (
  select p.* replace (greatest(coalesce(p.recorded_ns, r.recorded_ns, 9223372036854775806),
    (select max(known_ns) from specification_history where rejudges)) as recorded_ns)
  from placed p left join recorded r using (unit, run)
), edition as (
  select distinct specification, product, from_ns, until_ns, known_from_ns, known_until_ns, revisions
  from internal.limit_editions
), applied as (
  select m.unit, m.run, e.specification, min(greatest(e.known_from_ns, m.recorded_ns)) as known_ns
  from moment m join edition e on e.known_until_ns > m.recorded_ns
    and (e.product is null or e.product = m.product)
    and case when m.date_known then m.t_ns >= e.from_ns and m.t_ns < e.until_ns else e.revisions = 1 end
  group by m.unit, m.run, e.specification
), first_applied as (
  select unit, run, min(known_ns) as known_ns, map(list(specification), list(known_ns)) as first_known
  from applied group by unit, run
)
select m.unit, m.run, coalesce(a.known_ns, 9223372036854775806) as known_ns,
  if(a.known_ns > m.recorded_ns, a.first_known, null) as first_known
from moment m left join first_applied a using (unit, run);
-- A specification that never applied is known as well, unless it is of a later time and was entered since: that asks
-- for nothing.
create or replace macro internal.known_of(known_ns, first_known, specification, is_later) as
  if(first_known is null, known_ns, coalesce(first_known[specification], if(is_later, known_ns, 9223372036854775806)));

-- The products that specifications name, and of each unit the last such product: where a run is of a product that none
-- names, limits of that one were meant.
create or replace table internal.named_products as
select product from internal.limit_editions where product is not null union select product from internal.product_editions;
create or replace table internal.meant_products as
select unit, arg_max(product, (date_known, t_start_ns)) as product
from internal.tested_runs semi join internal.named_products using (product) group by unit;

-- The values of metrics that have limits, with the run that each is of: the last of those that it rests on; the unit's
-- last run where it rests on none.
create or replace table internal.metric_runs as
with limited as (
  select row_number() over () as row, * from unit_metrics where metric in (select metric from internal.limit_editions)
), over_several as (
  select r.row, arg_max(u.run, (u.date_known, u.t_start_ns, u.run)) as run
  from (select row, unit, unnest(runs) as run from limited where run is null) r
  join internal.tested_runs u on u.run = r.run and u.unit = r.unit
  group by r.row
)
select m.*,
  coalesce(u.product, l.product) as product, coalesce(u.lot, l.lot) as lot, coalesce(u.station, l.station) as station,
  coalesce(u.fixture, l.fixture) as fixture,
  case when u.run is null then l.day else u.day end as day,
  coalesce(u.date_known, l.date_known, false) as date_known,
  coalesce(u.t_start_ns, l.t_ns) as t_ns,
  k.known_ns as run_known_ns, k.first_known,
  -- a product that no specification names, of a run beside those of a product that one does
  if(u.product <> l.product and u.product not in (select product from internal.named_products), p.product, null) as meant_product
from limited m
left join over_several o on o.row = m.row
left join internal.tested_runs u on u.unit = m.unit and u.run = coalesce(m.run, o.run)
left join internal.judged_units l on l.unit = m.unit
left join internal.meant_products p on p.unit = m.unit
left join internal.run_known k on k.unit = m.unit and k.run = coalesce(u.run, l.run);

-- Which values have the parameters that a limit names. Numbers are alike to nine digits.
create or replace view internal.parameters_met as
with stated as (
  select row, metric, path, parameters->>path as text
  from internal.metric_runs join (select distinct metric, path from internal.specification_parameters) using (metric)
), keyed as (
  select row, metric, path, 'text ' || text as key from stated where text is not null
  union all
  select row, metric, path, 'number ' || printf('%.9g', try_cast(text as double)) from stated
  where try_cast(text as double) is not null
)
select k.row, p.limit_id, count(*) as met
from keyed k join internal.specification_parameters p on p.metric = k.metric and p.path = k.path and p.key = k.key
group by k.row, p.limit_id;

-- Of a value that has the Earth's rate in it: whether it is known how much.
create or replace macro is_earth_rate_known(parameters) as
  coalesce(not starts_with(parameters->>'$.earth_rate_in_it', 'up to'), false);
create or replace macro is_earth_rate_unknown(parameters) as
  coalesce(starts_with(parameters->>'$.earth_rate_in_it', 'up to'), false);

-- Every value with every limit that could be meant, whether or not it was valid then, or had been withdrawn.
create or replace view internal.limit_candidates as
with meant as (
  select m.row, s.limit_id from internal.metric_runs m join internal.limit_editions s using (metric)
  where s.parameter_count = 0
  union all
  select p.row, p.limit_id from internal.parameters_met p join internal.limit_editions s using (limit_id)
  where p.met = s.parameter_count
)
select m.* exclude (run_known_ns, first_known),
  s.* exclude (limit_id, metric, product, signal, standard, parameters, unit_of_measure),
  s.limit_id, s.unit_of_measure as limit_unit, s.parameters as limit_parameters, s.standard as limit_standard,
  s.product as limit_product, coalesce(s.product = m.meant_product, false) as is_mistyped,
  internal.known_of(m.run_known_ns, m.first_known, s.specification, m.date_known and m.t_ns < s.from_ns) as known_ns,
  known_ns < s.known_until_ns as is_known,
  -- where the date is not known, a specification that has never changed is the one that held
  case when m.date_known then m.t_ns >= s.from_ns and m.t_ns < s.until_ns else s.revisions = 1 end as is_valid
from meant
join internal.metric_runs m using (row)
join internal.limit_editions s using (limit_id)
where known_ns >= s.known_from_ns
  -- a value with the Earth's rate in it is judged where a limit asks for that, or nobody can remove it
  and (not is_earth_rate_known(m.parameters) or s.parameters->>'$.earth_rate' is not null)
  and (s.product is null or s.product = coalesce(m.meant_product, m.product))
  and (s.signal is null or s.signal = m.signal)
  and (s.standard is null or list_contains(string_split(m.standard, ', '), s.standard));

-- The early decisions on units that were released from their runs: on those limits they stand, since the record is short.
create or replace view internal.released_decisions as
with released as (
  select unit, run, max((document->>'$.recorded_s')::double) as recorded_s, max((document->>'$.planned_s')::double) as planned_s
  from internal.lake_documents where kind = 'UnitReleased' group by unit, run
), decided as (
  select d.unit, d.run, d.t_ns, d.document->>'$.signal' as signal, d.document->>'$.limit.characteristic' as characteristic,
    (d.document->>'$.limit.tau_s')::double as tau_s, (d.document->>'$.limit.upper')::double as upper,
    d.document->>'$.limit.unit_of_measure' as unit_of_measure, d.document->>'$.outcome' as outcome,
    d.document->>'$.reason' as reason
  from internal.lake_documents d join released using (unit, run)
  where d.kind = 'EarlyDecision' and d.document->>'$.outcome' <> 'UNDECIDED'
)
select d.unit, d.run, d.signal,
  case d.characteristic when 'bias_stability' then 'bias_stability_averaged' else d.characteristic end as metric,
  d.tau_s, d.upper, d.unit_of_measure, arg_max(d.outcome, d.t_ns) as outcome,
  'decided early, after ' || printf('%.3g', any_value(r.recorded_s) / 3600) || ' h of '
    || printf('%.3g', any_value(r.planned_s) / 3600) || ' h: ' || arg_max(d.reason, d.t_ns) as reason
from decided d join released r using (unit, run)
group by d.unit, d.run, d.signal, metric, d.tau_s, d.upper, d.unit_of_measure;

create or replace macro internal.no_limit_for(product, others) as 'no limit is for its product ' || product || ', but for '
  || others || ': correct it with `gyrofleet import --units`, '
  || 'or add a table of that product to the specification where the limits for every product are all';

create or replace table internal.withdrawn_revisions as
select specification, revision, specification || '-' || revision || ' was withdrawn on '
    || strftime(make_timestamp(max(t_ns) // 1000), '%Y-%m-%d') || ' by ' || arg_max(entered_by, t_ns) || ': '
    || arg_max(reason, t_ns) as withdrawn
from specification_history where revision <> '' group by specification, revision
having arg_max(action, t_ns) = 'withdrawn';

-- `is_unjudged`: a value is there that nothing judges. It was measured after the first revision of a specification that
-- has a limit for it, where no revision was valid, or after a value that was judged, and lacks what its rule needs.
create or replace table verdicts as
with meant as materialized (
  select * from internal.limit_candidates
), candidate as (
  from meant where is_known
), lacking_samples as (                 -- records that lack more than a tenth of their samples
  select run, unit, signal, list("index") as lacking_steps, arg_min(n, n / expected) as n, arg_min(expected, n / expected) as expected
  from step_means where n < 0.9 * expected and lacks_samples(n, expected) group by run, unit, signal
), converted as (                       -- in the unit of the limit
  select c.*, c.value * f.factor as v, c.lo * f.factor as v_lo, c.hi * f.factor as v_hi,
    c."U" * abs(f.factor) as v_u_expanded, stated_uncertainty(c."U") * abs(f.factor) as v_u_stated, coalesce(c."U" / c.k, c.standard_uncertainty) * abs(f.factor) as v_u,
    case when c."U" is null then c.freedom else c.nu end as v_nu
  from candidate c
  left join internal.result_factors f on f.source = c.unit_of_measure and f.target = c.limit_unit
  where c.is_valid and not c.is_mistyped
  -- a specification of another name that is entered later for the same does not judge again
  qualify c.known_ns = min(c.known_ns) over (partition by c.row, c.limit_parameters, c.limit_standard)
), widened as (                         -- the 95 % interval, as wide as U where that is known and wider
  select * replace (
    case when decision_rule = 'interval' and v_lo is not null then least(v_lo, v - v_u_expanded) else v_lo end as v_lo,
    case when decision_rule = 'interval' and v_hi is not null then greatest(v_hi, v + v_u_expanded) else v_hi end as v_hi)
  from converted
), guarded as (                         -- width of the guard band of JCGM 106 8.3, towards the inside, of U as it is printed
  select *,
    case decision_rule when 'guarded_acceptance' then guard_factor * v_u_stated
      when 'guarded_rejection' then -guard_factor * v_u_stated else 0.0 end as guard,
    -- a standard out of date makes no value better than it was while that was valid
    case when v_u_expanded is null then nullif(regexp_extract(uncertainty_reason,
      'the calibration of ' || '.+?' || ' ended on ' || '[0-9-]+'), '') end as expired,
    student_as_normal((upper - v) / nullif(v_u, 0), coalesce(v_nu, 1e9)) as z_upper,
    student_as_normal((lower - v) / nullif(v_u, 0), coalesce(v_nu, 1e9)) as z_lower
  from widened
), by_value as (
  select *,
    case
      when v is null then 'NO_DATA'
      when decision_rule <> 'interval' then
        case when guard is null or (decision_rule = 'shared_risk' and v_u_expanded is null) then 'NO_DATA'
          when decision_rule = 'shared_risk' and v_u_stated > "largest_U" * (1 + 1e-9) then 'MARGINAL'
          when v > upper - guard or v < lower + guard then 'FAIL'
          else 'PASS' end
      when v_lo > upper or v_hi < lower then 'FAIL'
      when (upper is null or v_hi <= upper) and (lower is null or v_lo >= lower) then 'PASS'
      else 'MARGINAL'
    end as by_value,
    case when v_u > 0 and expired is null then
      case when upper is null then 1.0 else normal_cdf(z_upper) end
      - case when lower is null then 0.0 else normal_cdf(z_lower) end
    end as conformity
  from guarded
), lasted as (                          -- how long the records are of values whose limits ask for it
  select g.row, g.limit_id, coalesce(any_value((g.parameters->>'$.duration_s')::double),
    sum((m.t_to_ns - m.t_from_ns) / 1e9)) as record
  from guarded g left join step_means m on m.run = g.run and m.unit = g.unit and m.signal = g.signal
    and list_contains(g.steps, m."index")
  where g.record_s is not null group by g.row, g.limit_id
), judged as (                          -- an early decision stands, unless the value says the opposite
  select b.*, case when b.conformity is not null then if(b.v_u_expanded is null, 'type A only', 'U') end as conformity_of,
    d.reason as early_reason, d.outcome as early, l.n as samples, l.expected, r.record,
    b.record_s is not null and coalesce(r.record, 0) < 0.99 * b.record_s as is_short,
    case
      when v is not null and is_earth_rate_unknown(b.parameters) then 'MARGINAL'
      when is_short and by_value = 'PASS' and d.outcome is distinct from 'FAIL' then 'MARGINAL'
      when expired is not null and by_value = 'PASS' and d.outcome is distinct from 'FAIL' then 'MARGINAL'
      when d.outcome is null and by_value = 'PASS' and l.n is not null then 'MARGINAL'
      when d.outcome is null then by_value
      when d.outcome = 'PASS' and by_value = 'FAIL' or d.outcome = 'FAIL' and by_value = 'PASS' then 'MARGINAL'
      else d.outcome
    end as verdict
  from by_value b
  left join internal.released_decisions d on d.unit = b.unit and d.run = b.run and d.signal = b.signal
    and d.metric = b.metric and b.lower is null
    and abs(d.upper - b.upper * coalesce((select f.factor from internal.result_factors f
      where f.source = b.limit_unit and f.target = d.unit_of_measure), 1)) <= 1e-9 * d.upper
    and (d.metric = 'angle_random_walk'
      or abs(d.tau_s - coalesce((b.parameters->>'$.average_s')::double, (b.parameters->>'$.tau_s')::double)) <= 1e-6 * d.tau_s)
  left join lasted r on r.row = b.row and r.limit_id = b.limit_id
  left join lacking_samples l on l.run = b.run and l.unit = b.unit and l.signal = b.signal
    and list_has_any(l.lacking_steps, b.steps)
), of_values as (
  select unit, signal, run, metric, subject, verdict, v as value, v_lo as lo, v_hi as hi, lower, upper,
    limit_unit as unit_of_measure, decision_rule, conformity, conformity_of, v_u as standard_uncertainty,
    -- what the rule asks for inside the limit; the half-width of the interval where that decides
    case decision_rule when 'interval' then greatest(v_hi - v, v - v_lo) else guard end as guard, parameters, runs, standard, clause,
    specification, revision,
    case
      when v is not null and is_earth_rate_unknown(parameters) then parameters->>'$.remark'
      when is_short and by_value = 'PASS' and verdict = 'MARGINAL' then
        coalesce('its record lasts ' || printf('%.4g', record) || ' s', 'the length of its record is not known')
        || ', the limit asks for ' || printf('%.4g', record_s) || ' s: measure longer'
      when expired is not null and by_value in ('PASS', 'FAIL')
        then expired || ', so that nothing states how far off it measures: have it calibrated and measure again, or '
          || 'give its new certificate with --restate'
      when early = verdict then early_reason
      when early is not null then early || ' was ' || early_reason || '; the value says ' || by_value || ': test it again'
      when v is null and value is null then reason
      when v is null then 'the value is in ' || unit_of_measure || ', the limit in ' || limit_unit
      when by_value = 'NO_DATA' then 'no U, which the rule ' || decision_rule || ' needs: ' || coalesce(uncertainty_reason, '')
      when decision_rule = 'shared_risk' and verdict = 'MARGINAL' then format('U = {:.3g} is more than the {:.3g} up to '
        || 'which risks are shared: measure with a smaller one', v_u_stated, "largest_U")
      when by_value = 'PASS' and verdict = 'MARGINAL'
        then samples || ' of ' || expected || ' samples of its record are there: a PASS needs nine tenths'
      when decision_rule = 'guarded_acceptance' and verdict = 'FAIL' and (upper is null or v <= upper)
        and (lower is null or v >= lower) then format('inside the limit, but by less than the guard band of {:.3g} {} '
        || '({:.3g} U)', guard, limit_unit, guard_factor)
      when decision_rule = 'guarded_rejection' and verdict = 'PASS' and (v > upper or v < lower)
        then format('outside the limit, but by less than the guard band of {:.3g} {} ({:.3g} U)', -guard, limit_unit, guard_factor)
      when decision_rule <> 'interval' then null
      when verdict = 'MARGINAL' and (v_lo is null or v_hi is null)
        then 'the value has no interval, which the rule needs'
          || coalesce(': ' || (parameters->>'$.remark'), '; simple_acceptance judges by the value alone')
      when verdict = 'MARGINAL' then 'the limit lies inside the 95 % interval: the data do not decide'
    end as reason,
    product, lot, station, fixture, day, t_ns, date_known, verdict = 'NO_DATA' and value is not null
      and t_ns > max(t_ns) filter (verdict <> 'NO_DATA') over (
        partition by unit, signal, metric, subject, standard, specification) as is_unjudged
  from judged
), not_judged as (                      -- that limits have asked for, of which none was valid and known at the time
  from meant anti join (select row from candidate where is_valid and not is_mistyped) v using (row) where not is_mistyped
), mistyped as (                        -- that a limit asks for, but for the unit's other product
  select unit, signal, run, metric, subject, 'NO_DATA' as verdict, value, lo, hi, null::double as lower,
    null::double as upper, unit_of_measure, parameters, runs, standard, clause, specification, null::varchar as revision,
    internal.no_limit_for(product, limit_product) as reason, product, lot, station, fixture, day, t_ns, date_known,
    true as is_unjudged
  from candidate where is_mistyped and is_valid and value is not null
), valid_then as (                      -- what the revisions of such a specification limit that were
  select n.row, n.specification, string_agg(distinct s.revision, ', ' order by s.revision) as revision,
    bool_or(s.product is null or s.product = n.product) as is_for_product,
    bool_or(s.metric = n.metric and (s.product is null or s.product = n.product)) as is_limited,
    string_agg(distinct s.product, ', ' order by s.product) filter (s.metric = n.metric and s.product <> n.product)
      as limited_of
  from (select distinct row, specification, metric, product, date_known, t_ns, known_ns from not_judged) n
  join internal.limit_editions s on s.specification = n.specification
    and n.known_ns >= s.known_from_ns and n.known_ns < s.known_until_ns
    and case when n.date_known then n.t_ns >= s.from_ns and n.t_ns < s.until_ns else s.revisions = 1 end
  group by n.row, n.specification
), there_is as (
  select row, specification, string_agg(revision || ' ' || valid, ', ' order by revision) as revisions
  from (
    select n.row, n.specification, n.revision,
      arg_max(n.valid, (n.is_known, n.known_from_ns)) || if(any_value(w.revision) is null, '', ' (withdrawn)') as valid
    from not_judged n left join internal.withdrawn_revisions w using (specification, revision)
    group by n.row, n.specification, n.revision
  ) group by row, specification
), outside as (                         -- a revision for its product that no longer has the limit asks for nothing
  select n.unit, n.signal, n.run, n.metric, arg_max(n.subject, (n.known_until_ns, n.from_ns, -n.limit_id)) as subject,
    'NO_DATA' as verdict, any_value(n.value) as value, any_value(n.lo) as lo, any_value(n.hi) as hi,
    null::double as lower, null::double as upper, any_value(n.unit_of_measure) as unit_of_measure,
    any_value(n.parameters) as parameters, any_value(n.runs) as runs, any_value(n.standard) as standard,
    any_value(n.clause) as clause, n.specification, null::varchar as revision,
    case
      when not bool_or(n.is_known) then 'no revision of ' || n.specification || ' in force judges it'
      when not bool_and(n.date_known)
        then 'the date of the run is not known, so nobody can say which revision of ' || n.specification || ' held'
      when any_value(v.revision) is null then 'no revision of ' || n.specification || ' was valid at '
        || strftime(make_timestamp(any_value(n.t_ns) // 1000), '%Y-%m-%d')
      else n.specification || '-' || any_value(v.revision) || ', valid at '
        || strftime(make_timestamp(any_value(n.t_ns) // 1000), '%Y-%m-%d') || ', has no limit for '
        || coalesce('product ' || any_value(n.product) || ', but for ' || any_value(v.limited_of), 'its product')
    end || ': there is ' || any_value(t.revisions) as reason,
    any_value(n.product) as product, any_value(n.lot) as lot, any_value(n.station) as station,
    any_value(n.fixture) as fixture, any_value(n.day) as day, any_value(n.t_ns) as t_ns,
    bool_and(n.date_known) as date_known,
    any_value(n.value) is not null and not (bool_and(n.date_known) and any_value(n.t_ns) < min(n.from_ns)) as is_unjudged
  from not_judged n
  left join valid_then v on v.row = n.row and v.specification = n.specification
  left join there_is t on t.row = n.row and t.specification = n.specification
  where not coalesce(v.is_for_product and (v.is_limited or v.limited_of is null), false)
  group by n.row, n.unit, n.signal, n.run, n.metric, n.specification
), explained as (                       -- values whose row says that no limit of their product was in force
  select o.unit, o.product, o.t_ns, o.is_unjudged
  from outside o semi join internal.limit_editions s
    on s.specification = o.specification and s.metric = o.metric and s.product = o.product
), in_force as (                        -- the limits that held when a unit was last tested or checked, of any product
  select u.unit, u.run, u.product, u.lot, u.station, u.fixture, u.day, u.t_ns, u.lack,
    s.* exclude (product), s.signal as limit_signal, s.product as limit_product
  from internal.judged_units u join internal.run_known k on k.unit = u.unit and k.run = u.run
  join internal.limit_editions s
    -- limits of other products make no unit doubtful that was judged before them
    on if(s.product <> u.product, k.known_ns, internal.known_of(k.known_ns, k.first_known, s.specification, false))
      between s.known_from_ns and s.known_until_ns - 1
    and case when u.date_known then u.t_ns >= s.from_ns and u.t_ns < s.until_ns else s.revisions = 1 end
), asked as (                           -- limits for every product apply to each unit
  select * exclude (limit_product) from in_force where limit_product is null or limit_product = product
), unknown_product as (                 -- limits of its product may be among those that nobody can apply
  select unit, null::varchar as signal, null::varchar as run, 'product' as metric, 'product' as subject,
    'NO_DATA' as verdict, null::double as value, null::double as lo, null::double as hi, null::double as lower,
    null::double as upper, '' as unit_of_measure, '{}' as parameters, []::varchar[] as runs,
    null::varchar as standard, null::varchar as clause, null::varchar as specification, null::varchar as revision,
    case when product is null
      then 'its product is not known, so that no limit of ' || string_agg(distinct limit_product, ', ' order by limit_product)
        || ' is applied: name its product with `gyrofleet import --units`, or where it is mounted'
      when product in (select product from internal.named_products)
        then 'no limit for its product ' || product || ' was in force at ' || any_value(day)
      else internal.no_limit_for(product, string_agg(distinct limit_product, ', ' order by limit_product))
    end as reason,
    product, any_value(lot) as lot, any_value(station) as station, any_value(fixture) as fixture,
    any_value(day) as day, any_value(t_ns) as t_ns
  from in_force f anti join explained e
    on e.unit = f.unit and e.product = f.product and (e.is_unjudged or e.t_ns >= f.t_ns)
  where limit_product is not null and (product is null or product not in (select product from internal.product_editions))
  group by unit, product
  having product is null or not bool_or(limit_product = product)
), without_output as (                  -- units of whose steps none has the output of a gyro
  select unit, string_agg(distinct coalesce("procedure", step, 'of no procedure'), ', '
      order by coalesce("procedure", step, 'of no procedure')) as procedures,
    string_agg(distinct signal, ', ' order by signal) as signals
  from step_means anti join internal.gyro_steps g using (unit) where signal is not null group by unit
), lacking as (
  select a.unit, a.limit_signal as signal, null::varchar as run, a.metric, a.subject, 'NO_DATA' as verdict,
    null::double as value, null::double as lo, null::double as hi, a.lower, a.upper, a.unit_of_measure, a.parameters,
    []::varchar[] as runs, coalesce(a.standard, n.standard) as standard, n.clause, a.specification, a.revision,
    case when a.lack is not null then a.lack
      when n.metric is null then 'this gyrofleet has no metric ' || a.metric
        || ': it is of a later version, or an own file that this installation lacks (GYROFLEET_OWN)'
      when h.unit is null and o.unit is not null and not regexp_matches(n.needs, '^(entered|an entered)')
          and not regexp_matches(a.metric, '^(power|accelerometer_|attitude_unit_|system_level_accelerometer_)')  -- of no gyro
        then 'its steps (' || o.procedures || ') are there, but without the output of a gyro (of ' || o.signals
          || ' alone): import a column of its rate, or name its output rate'
      when h.unit is null then 'not measured: it needs ' || n.needs
      when a.metric = 'bias_stability_averaged' and a.parameters->>'$.average_s' is not null
          and not list_contains([1.0, 10.0, 100.0, p.average_s], try_cast(a.parameters->>'$.average_s' as double))
        then 'averages of ' || replace(a.parameters->>'$.average_s', '.0', '') || ' s are not computed: write average_s = '
          || replace(a.parameters->>'$.average_s', '.0', '') || ' in [product."' || coalesce(a.product, 'NAME')
          || '"] of its specification, and enter that with `gyrofleet limits revise --rejudge`'
      else 'values of ' || a.metric || ' are there, but none of ' || a.subject
        || ': `gyrofleet metrics --metric ' || a.metric || '` shows which' end as reason,
    a.product, a.lot, a.station, a.fixture, a.day, a.t_ns
  from asked a
  left join metric_names n on n.metric = a.metric
  left join (select distinct unit, metric from unit_metrics) h on h.unit = a.unit and h.metric = a.metric
  left join without_output o on o.unit = a.unit
  left join internal.run_products p on p.unit = a.unit and p.run = a.run
  anti join (select distinct unit, specification, subject from candidate) c
    on c.unit = a.unit and c.specification = a.specification and c.subject = a.subject
), entered as (
  select e.unit, null::varchar as signal, nullif(e.run, '') as run,
    case e.document->>'$.item' when 'visual' then 'visual_check' when 'electrical' then 'electrical_check'
      else e.document->>'$.item' end as metric,
    'entered' as subject, e.document->>'$.verdict' as verdict,
    (e.document->>'$.value')::double as value, null::double as lo, null::double as hi,
    (e.document->>'$.lower')::double as lower, (e.document->>'$.upper')::double as upper,
    coalesce(e.document->>'$.unit_of_measure', '') as unit_of_measure,
    to_json({'by': e.document->>'$.by'})::varchar as parameters,
    case when e.run = '' then [] else [e.run] end as runs, 'GJB2426A' as standard,
    case e.document->>'$.item' when 'visual' then '5.2' when 'electrical' then '5.3' end as clause,
    null::varchar as specification, null::varchar as revision, e.document->>'$.note' as reason,
    u.product, u.lot, u.station, u.fixture, make_timestamp_ns(e.t_ns)::date as day, e.t_ns
  from internal.standing_checks e left join internal.judged_units u on u.unit = e.unit
)
select v.* replace (coalesce(v.is_unjudged, false) as is_unjudged), w.withdrawn from (
  select * from of_values
  union all by name select * from outside
  union all by name select * from mistyped
  union all by name select * from lacking
  union all by name select * from unknown_product
  union all by name select * from entered
) v left join internal.withdrawn_revisions w on w.specification = v.specification and w.revision = v.revision;
comment on table verdicts is 'each value against its limit: PASS, FAIL, MARGINAL or NO_DATA with the reason, by the revision valid at the time';
