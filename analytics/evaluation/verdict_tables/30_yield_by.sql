-- Where units without any verdict but NO_DATA were measured, or were to be.
create or replace view internal.unlimited_units as
with judged as (
  select distinct unit from verdicts where verdict <> 'NO_DATA'
)
select unit, run, product, lot, station, fixture, day, t_start_ns as t_ns from internal.tested_runs anti join judged using (unit)
union all
select unit, run, product, lot, station, fixture, day, t_ns from internal.judged_units anti join judged using (unit)
where lack is not null;

create or replace macro internal.week_of(day) as strftime(day, '%G-W%V');
create or replace macro internal.month_of(day) as strftime(day, '%Y-%m');
-- Whether something was measured in a group: of a product, lot, station, fixture, day, ISO week or month, in a run, of
-- some units, since a moment or a day. Days are those of the station. Empty asks for all, '(not given)' for what has none.
create or replace macro internal.is_of(name, asked) as asked = '' or coalesce(name, '(not given)') = asked;
create or replace macro internal.is_in_group(
  product, lot, station, fixture, day, run, unit, t_ns,
  of_product, of_lot, of_station, of_fixture, of_day, of_week, of_month, of_run, of_units, since_ns, of_since_day
) as internal.is_of(product, of_product) and internal.is_of(lot, of_lot)
  and internal.is_of(station, of_station) and internal.is_of(fixture, of_fixture)
  and (of_day = '' or day::varchar = of_day) and (of_week = '' or internal.week_of(day) = of_week)
  and (of_month = '' or internal.month_of(day) = of_month)
  and (of_run = '' or run = of_run) and (len(of_units) = 0 or list_contains(of_units, unit)) and (since_ns is null or t_ns >= since_ns)
  and (of_since_day = '' or day::varchar >= of_since_day);
create or replace macro internal.verdicts_in(
  of_product := '', of_lot := '', of_station := '', of_fixture := '', of_day := '', of_week := '', of_month := '',
  of_run := '', of_units := [], since_ns := null, of_since_day := ''
) as table
select unit, signal, metric, subject, standard, specification, revision, verdict, decision_rule, product, lot, station, fixture, day,
  t_ns, date_known, is_unjudged, withdrawn
from verdicts
where internal.is_in_group(product, lot, station, fixture, day, run, unit, t_ns,
  of_product, of_lot, of_station, of_fixture, of_day, of_week, of_month, of_run, of_units, since_ns, of_since_day);
create or replace macro internal.unlimited_in(
  of_product := '', of_lot := '', of_station := '', of_fixture := '', of_day := '', of_week := '', of_month := '',
  of_run := '', of_units := [], since_ns := null, of_since_day := ''
) as table
select distinct unit, product, lot, station, fixture, day
from internal.unlimited_units
where internal.is_in_group(product, lot, station, fixture, day, run, unit, t_ns,
  of_product, of_lot, of_station, of_fixture, of_day, of_week, of_month, of_run, of_units, since_ns, of_since_day);

-- How many units are good: of all, and of each product, lot, station, fixture, day, week or month, of those in a group.
-- Each kind of group judges a unit by what was measured in it. The yield is of the units that are decided or marginal;
-- its 95 % interval is Wilson's. `first_passed`, `latest_passed`: units that pass by the first, or the last, value of each
-- limit there, as before and after a repair. Units without a verdict are NO_DATA wherever they were measured. Units that pass in a
-- group though a limit of the revision that judged them there was judged elsewhere only are counted, with these metrics.
create or replace macro internal.yield_in(
  of_product := '', of_lot := '', of_station := '', of_fixture := '', of_day := '', of_week := '', of_month := '',
  of_run := '', of_units := [], since_ns := null, of_since_day := ''
) as table
with judged as (
  from internal.verdicts_in(of_product := of_product, of_lot := of_lot, of_station := of_station,
    of_fixture := of_fixture, of_day := of_day, of_week := of_week, of_month := of_month, of_run := of_run,
    of_units := of_units, since_ns := since_ns, of_since_day := of_since_day)
), unlimited as (
  from internal.unlimited_in(of_product := of_product, of_lot := of_lot, of_station := of_station,
    of_fixture := of_fixture, of_day := of_day, of_week := of_week, of_month := of_month, of_run := of_run,
    of_units := of_units, since_ns := since_ns, of_since_day := of_since_day)
), placed as (
  select 'all' as kind, 'all' as name, * from judged
  union all select 'product', product, * from judged
  union all select 'lot', lot, * from judged
  union all select 'station', station, * from judged
  union all select 'fixture', fixture, * from judged
  union all select 'day', day::varchar, * from judged
  union all select 'week', internal.week_of(day), * from judged
  union all select 'month', internal.month_of(day), * from judged
), each_limit as (                      -- as in unit_verdicts
  select kind, name, unit, specification,
    worst_rank(verdict, is_unjudged) as rank,
    first_rank(verdict, is_unjudged, date_known, t_ns) as first_rank,
    latest_rank(verdict, is_unjudged, date_known, t_ns) as latest_rank,
    signal, metric, subject, max(revision) as revision
  from placed group by kind, name, unit, signal, metric, subject, standard, specification
), limit_of_unit as (                   -- that were judged anywhere
  select distinct unit, signal, metric, subject, specification from verdicts
  where specification is not null and verdict <> 'NO_DATA'
), judged_by as (
  select distinct kind, name, unit, specification, revision from each_limit where rank <> 3
), not_judged as (
  select b.kind, b.name, b.unit, l.metric
  from judged_by b join limit_of_unit l using (unit, specification)
  semi join internal.limit_editions e
    on e.specification = b.specification and e.revision = b.revision and e.metric = l.metric and e.subject = l.subject
  anti join (from each_limit where rank <> 3) j
    on j.kind = b.kind and j.name is not distinct from b.name and j.unit = b.unit and j.specification = b.specification
    and j.metric = l.metric and j.subject = l.subject and j.signal is not distinct from l.signal
), each_unit as (
  select kind, name, unit, unit_verdict(min(rank), count(specification)) as verdict,
    unit_verdict(min(first_rank), count(specification)) as first_verdict,
    unit_verdict(min(latest_rank), count(specification)) as latest_verdict
  from each_limit group by kind, name, unit
), every_unit as (
  from each_unit
  union select 'all', 'all', unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'product', product, unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'lot', lot, unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'station', station, unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'fixture', fixture, unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'day', day::varchar, unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'week', internal.week_of(day), unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
  union select 'month', internal.month_of(day), unit, 'NO_DATA', 'NO_DATA', 'NO_DATA' from unlimited
), counted as (
  select kind, name, count(*) as units,
    count(*) filter (verdict = 'PASS') as passed,
    count(*) filter (verdict = 'FAIL') as failed,
    count(*) filter (verdict = 'MARGINAL') as marginal,
    count(*) filter (verdict = 'NO_DATA') as no_data,
    count(*) filter (first_verdict = 'PASS') as first_passed, count(*) filter (latest_verdict = 'PASS') as latest_passed,
    count(*) filter (first_verdict <> 'NO_DATA') as first_judged, count(*) filter (latest_verdict <> 'NO_DATA') as latest_judged
  from every_unit group by kind, name
), partly as (
  select u.kind, u.name, count(distinct u.unit) as not_all_limits, list(distinct n.metric order by n.metric) as not_judged
  from each_unit u join not_judged n
    on n.kind = u.kind and n.name is not distinct from u.name and n.unit = u.unit
  where u.verdict = 'PASS' group by u.kind, u.name
), rules as (
  select kind, name, list(distinct decision_rule order by decision_rule) filter (decision_rule is not null)
      as decision_rules, list(distinct unit order by unit) filter (is_unjudged) as unjudged,
    list(distinct withdrawn order by withdrawn) filter (withdrawn is not null) as withdrawn
  from placed group by kind, name
), shares as (
  select *, nullif(units - no_data, 0) as n, passed / nullif(units - no_data, 0) as share,
    1.959963984540054 as z
  from counted
)
select s.kind, s.name, units, passed, failed, marginal, no_data, first_passed, first_judged, latest_passed, latest_judged,
  share as yield,
  greatest(0, (share + z * z / (2 * n) - z * sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)) as yield_lo,
  least(1, (share + z * z / (2 * n) + z * sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)) as yield_hi,
  coalesce(p.not_all_limits, 0) as not_all_limits, coalesce(p.not_judged, []) as not_judged,
  coalesce(r.unjudged, []) as unjudged, coalesce(r.withdrawn, []) as withdrawn, coalesce(r.decision_rules, []) as decision_rules,
  case when n is null then 'none of its units has a verdict: all are NO_DATA' end as reason
from shares s left join rules r on r.kind = s.kind and r.name is not distinct from s.name
left join partly p on p.kind = s.kind and p.name is not distinct from s.name
order by s.kind, s.name nulls last;
create or replace view yield_by as from internal.yield_in();
comment on view yield_by is 'yield by product, lot, station, fixture, day, week and month (column kind), with its 95 % interval';
