-- Where units that no limit applies to were measured, or were to be.
create or replace view internal.unlimited_units as
select unit, lot, station, fixture, day from unit_runs anti join verdicts using (unit)
union all
select unit, lot, station, fixture, day from internal.judged_units anti join verdicts using (unit) where lack is not null;

-- How many units of a lot, station, fixture or day are good. Each group judges a unit by what was measured in it. The
-- yield is of the units that are decided or marginal; its 95 % interval is Wilson's. Units that no limit applies to are
-- NO_DATA where they were measured.
create or replace view yield_by as
with judged as materialized (
  select unit, signal, metric, subject, standard, specification, verdict, decision_rule, lot, station, fixture, day from verdicts
), placed as (
  select 'lot' as kind, lot as name, * from judged
  union all select 'station', station, * from judged
  union all select 'fixture', fixture, * from judged
  union all select 'day', day::varchar, * from judged
), each_limit as (                      -- as in unit_verdicts
  select kind, name, unit, specification,
    coalesce(min(verdict_rank(verdict)) filter (verdict <> 'NO_DATA'), 3) as rank
  from placed group by kind, name, unit, signal, metric, subject, standard, specification
), each_unit as (
  select kind, name, unit, unit_verdict(min(rank), count(specification)) as verdict
  from each_limit group by kind, name, unit
), every_unit as (
  from each_unit
  union all select distinct 'lot', lot, unit, 'NO_DATA' from internal.unlimited_units
  union all select distinct 'station', station, unit, 'NO_DATA' from internal.unlimited_units
  union all select distinct 'fixture', fixture, unit, 'NO_DATA' from internal.unlimited_units
  union all select distinct 'day', day::varchar, unit, 'NO_DATA' from internal.unlimited_units
), counted as (
  select kind, name, count(*) as units,
    count(*) filter (verdict = 'PASS') as passed,
    count(*) filter (verdict = 'FAIL') as failed,
    count(*) filter (verdict = 'MARGINAL') as marginal,
    count(*) filter (verdict = 'NO_DATA') as no_data
  from every_unit group by kind, name
), rules as (
  select kind, name, list(distinct decision_rule order by decision_rule) filter (decision_rule is not null)
      as decision_rules
  from placed group by kind, name
), shares as (
  select *, nullif(units - no_data, 0) as n, passed / nullif(units - no_data, 0) as share,
    1.959963984540054 as z
  from counted
)
select s.kind, s.name, units, passed, failed, marginal, no_data, share as yield,
  greatest(0, (share + z * z / (2 * n) - z * sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)) as yield_lo,
  least(1, (share + z * z / (2 * n) + z * sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)) as yield_hi,
  coalesce(r.decision_rules, []) as decision_rules,
  case when n is null then 'none of its units has a verdict: all are NO_DATA' end as reason
from shares s left join rules r on r.kind = s.kind and r.name is not distinct from s.name
order by s.kind, s.name nulls last;
comment on view yield_by is 'yield by lot, station, fixture and day (column kind), with its 95 % interval';
