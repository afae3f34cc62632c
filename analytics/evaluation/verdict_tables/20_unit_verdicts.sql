-- One verdict for each unit: the worst of its limits. A limit's own verdict is the worst of its values; an attempt that
-- gave no value counts only where no other did, a value that nothing judges (`is_unjudged`) as NO_DATA. A unit passes only
-- where limits of a specification were judged: checks that were entered by hand can fail a unit, and do not pass it by
-- themselves. `latest_verdict` takes the last value of each limit instead: after a repair and a second test the two differ.
-- A value that nothing judges of a run whose date is not known may be the last.
create or replace macro worst_rank(verdict, is_unjudged) as
  coalesce(min(verdict_rank(verdict)) filter (verdict <> 'NO_DATA' or is_unjudged), 3);
create or replace macro internal.ordered_ns(is_unjudged, date_known, t_ns) as
  if(is_unjudged and not date_known, 9223372036854775807, t_ns);
create or replace macro latest_rank(verdict, is_unjudged, date_known, t_ns) as
  coalesce(arg_max(verdict_rank(verdict), (internal.ordered_ns(is_unjudged, date_known, t_ns), -verdict_rank(verdict)))
    filter (verdict <> 'NO_DATA' or is_unjudged), 3);
create or replace macro first_rank(verdict, is_unjudged, date_known, t_ns) as
  coalesce(arg_min(verdict_rank(verdict), (internal.ordered_ns(is_unjudged, date_known, t_ns), verdict_rank(verdict)))
    filter (verdict <> 'NO_DATA' or is_unjudged), 3);

create or replace table internal.limit_verdicts as
select unit, signal, metric, subject, if(subject = 'entered', '', coalesce(standard, '')) as of_standard, specification,
  verdict_of_rank(worst_rank(verdict, is_unjudged)) as verdict,
  verdict_of_rank(latest_rank(verdict, is_unjudged, date_known, t_ns)) as latest_verdict,
  count(*) as attempts,
  any_value(reason) filter (subject = 'product') as of_product  -- why no limit of its product is applied
from verdicts group by all;

-- What was measured of a unit and nothing judges: the last such value with its reason, and what is of before a specification.
create or replace view internal.unjudged_units as
with value as (
  select unit, is_unjudged, revision, metric || ' of run ' || coalesce(run, runs[-1]) as name, reason,
    internal.ordered_ns(is_unjudged, date_known, t_ns) as ns
  from verdicts where is_unjudged or verdict = 'NO_DATA' and value is not null and revision is null and specification is not null
)
select unit, count(*) filter (is_unjudged) as n, arg_max({name: name, reason: reason}, (ns, name)) filter (is_unjudged) as last,
  arg_max(name, (ns, name)) filter (not is_unjudged) as before
from value group by unit;

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
  nullif(concat_ws('; ', case
    when n.n = 1 then n.last.name || ' is not judged: ' || n.last.reason
    when n.n > 1 then n.last.name || ' and ' || (n.n - 1) || ' more are not judged: ' || n.last.reason
    when j.failed + j.marginal > 0 then null
    when j.limits > 0 then coalesce(j.of_product, n.before || ' was measured before its specification was valid, and is not judged')
    when exists (from internal.specification_problems) then
      (select min(problem) from internal.specification_problems) || '; `gyrofleet verify` has the details'
    when not exists (from internal.limit_editions) and exists (from internal.withdrawn_revisions) then
      'no revision is in force: ' || (select string_agg(withdrawn, ', ' order by withdrawn) from internal.withdrawn_revisions)
    when not exists (from internal.limit_editions) then 'the store has no limits: add a specification with `gyrofleet limits add`'
    when u.product is null then 'no limit applies to it: its product is not known'
    else 'no limit applies to it: no specification is for product ' || u.product
  end, w.withdrawn || ', and still judges this, which was recorded before',
  if(len(o.products) > 1, 'its runs are of several products: ' || array_to_string(o.products, ', '), null),
  if(len(o.lots) > 1, 'its runs are of several lots: ' || array_to_string(o.lots, ', '), null)), '') as reason
from known k left join judged j using (unit) left join internal.judged_units u using (unit)
left join internal.unjudged_units n using (unit)
left join (
  select unit, list(distinct product order by product) filter (product is not null) as products,
    list(distinct lot order by lot) filter (lot is not null) as lots
  from internal.tested_runs group by unit
) o using (unit)
left join (select unit, string_agg(distinct withdrawn, ', ' order by withdrawn) as withdrawn from verdicts group by unit) w
  using (unit)
order by k.unit;
comment on view unit_verdicts is 'one row for each unit: the worst of its verdicts, and the verdict of its latest values';
