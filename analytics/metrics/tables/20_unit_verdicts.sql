-- One verdict for each unit: the worst of its limits. A limit's own verdict is the worst of its values; an attempt that
-- gave no value counts only where no other did. `latest_verdict` takes the last value of each limit instead: after a
-- repair and a second test the two differ.
create or replace view limit_verdicts as
select unit, signal, metric, subject, of_standard, specification,
  verdict_of_rank(coalesce(min(verdict_rank(verdict)) filter (verdict <> 'NO_DATA'), 3)) as verdict,
  coalesce(arg_max(verdict, (t_ns, -verdict_rank(verdict))) filter (verdict <> 'NO_DATA'), 'NO_DATA') as latest_verdict,
  count(*) as attempts
from (select *, case when subject = 'entered' then '' else coalesce(standard, '') end as of_standard from verdicts)
group by unit, signal, metric, subject, of_standard, specification;

create or replace view unit_verdicts as
with judged as (
  select unit,
    verdict_of_rank(min(verdict_rank(verdict))) as verdict,
    verdict_of_rank(min(verdict_rank(latest_verdict))) as latest_verdict,
    count(*) filter (verdict = 'PASS') as passed,
    count(*) filter (verdict = 'FAIL') as failed,
    count(*) filter (verdict = 'MARGINAL') as marginal,
    count(*) filter (verdict = 'NO_DATA') as no_data,
    coalesce(list(distinct metric order by metric) filter (verdict = 'FAIL'), []) as failures,
    coalesce(list(distinct metric order by metric) filter (verdict = 'MARGINAL'), []) as undecided,
    coalesce(list(distinct metric order by metric) filter (verdict = 'NO_DATA'), []) as lacking
  from limit_verdicts group by unit
), known as (
  select unit from unit_last_run union select unit from unit_metrics union select unit from lake_documents where kind = 'CheckEntered'
)
select k.unit, u.product, u.lot, coalesce(j.verdict, 'NO_DATA') as verdict,
  coalesce(j.latest_verdict, 'NO_DATA') as latest_verdict,
  coalesce(j.passed, 0) as passed, coalesce(j.failed, 0) as failed, coalesce(j.marginal, 0) as marginal,
  coalesce(j.no_data, 0) as no_data, coalesce(j.failures, []) as failures,
  coalesce(j.undecided, []) as undecided, coalesce(j.lacking, []) as lacking,
  case
    when j.unit is not null then null
    when not exists (from specification_limits) then 'the store has no limits: add a specification with `gyrofleet limits add`'
    when u.product is null then 'no limit applies to it: its product is not known'
    else 'no limit applies to it: no specification is for product ' || u.product
  end as reason
from known k left join judged j using (unit) left join unit_last_run u using (unit)
order by k.unit;
comment on view unit_verdicts is 'one row for each unit: the worst of its verdicts, and the verdict of its latest values';
