-- One verdict for each unit: the worst of its limits. A limit's own verdict is the worst of its values; an attempt that
-- gave no value counts only where no other did. A unit passes only where limits of a specification were judged: checks
-- that were entered by hand can fail a unit, and do not pass it by themselves. `latest_verdict` takes the last value of each
-- limit instead: after a repair and a second test the two differ. A value of a run whose date is not known, so that
-- nobody can say which revision judges it, keeps its unit from passing.
create or replace table internal.limit_verdicts as
with undated as (
  select distinct m.unit, m.run, m.metric from unit_metrics m join unit_runs r on r.unit = m.unit and r.run = m.run
  where not r.date_known and m.value is not null
), attempt as (
  select v.*, case when subject = 'entered' then '' else coalesce(standard, '') end as of_standard,
    u.run is not null and v.revision is null and v.specification is not null as is_unjudged
  from verdicts v left join undated u on u.unit = v.unit and u.run = v.run and u.metric = v.metric
), unjudged as (
  select distinct unit, metric, specification, signal from attempt where is_unjudged
)
select a.unit, a.signal, a.metric, a.subject, a.of_standard, a.specification,
  verdict_of_rank(least(
    coalesce(min(verdict_rank(verdict)) filter (verdict <> 'NO_DATA'), 3), if(bool_or(u.unit is not null), 3, 4)))
    as verdict,
  case when bool_or(u.unit is not null) then 'NO_DATA' else
    coalesce(arg_max(verdict, (t_ns, -verdict_rank(verdict))) filter (verdict <> 'NO_DATA'), 'NO_DATA') end
    as latest_verdict,
  count(*) as attempts,
  any_value(reason) filter (subject = 'product') as of_product  -- why no limit of its product is applied
from attempt a left join unjudged u
  on u.unit = a.unit and u.metric = a.metric and u.specification = a.specification
  and u.signal is not distinct from a.signal
group by a.unit, a.signal, a.metric, a.subject, a.of_standard, a.specification;

create or replace macro unit_verdict(worst_rank, limits) as
  case when worst_rank = 4 and limits = 0 then 'NO_DATA' else verdict_of_rank(worst_rank) end;

create or replace view unit_verdicts as
with judged as (
  select unit,
    count(specification) as limits,
    any_value(of_product) as of_product,
    unit_verdict(min(verdict_rank(verdict)), count(specification)) as verdict,
    unit_verdict(min(verdict_rank(latest_verdict)), count(specification)) as latest_verdict,
    count(*) filter (verdict = 'PASS') as passed,
    count(*) filter (verdict = 'FAIL') as failed,
    count(*) filter (verdict = 'MARGINAL') as marginal,
    count(*) filter (verdict = 'NO_DATA') as no_data,
    coalesce(list(distinct metric order by metric) filter (verdict = 'FAIL'), []) as failures,
    coalesce(list(distinct metric order by metric) filter (verdict = 'MARGINAL'), []) as undecided,
    coalesce(list(distinct metric order by metric) filter (verdict = 'NO_DATA'), []) as lacking
  from internal.limit_verdicts group by unit
), known as (
  select unit from internal.judged_units union select unit from unit_metrics
)
select k.unit, u.product, u.lot, coalesce(j.verdict, 'NO_DATA') as verdict,
  coalesce(j.latest_verdict, 'NO_DATA') as latest_verdict,
  coalesce(j.passed, 0) as passed, coalesce(j.failed, 0) as failed, coalesce(j.marginal, 0) as marginal,
  coalesce(j.no_data, 0) as no_data, coalesce(j.failures, []) as failures,
  coalesce(j.undecided, []) as undecided, coalesce(j.lacking, []) as lacking,
  case
    when j.failed + j.marginal > 0 then null
    when j.limits > 0 then j.of_product
    when exists (from internal.specification_problems) then
      (select min(problem) from internal.specification_problems) || '; `gyrofleet verify` has the details'
    when not exists (from internal.limit_editions) then 'the store has no limits: add a specification with `gyrofleet limits add`'
    when u.product is null then 'no limit applies to it: its product is not known'
    else 'no limit applies to it: no specification is for product ' || u.product
  end as reason
from known k left join judged j using (unit) left join internal.judged_units u using (unit)
order by k.unit;
comment on view unit_verdicts is 'one row for each unit: the worst of its verdicts, and the verdict of its latest values';
