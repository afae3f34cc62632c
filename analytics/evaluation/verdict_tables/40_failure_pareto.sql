-- What units fail by, the most frequent first; a unit counts once for each limit. Shares are of all failures.
create or replace view failure_pareto as
with counted as (
  select metric, subject,
    count(distinct unit) filter (verdict = 'FAIL') as failed,
    count(distinct unit) filter (verdict = 'MARGINAL') as marginal,
    count(distinct unit) filter (verdict <> 'NO_DATA') as judged
  from internal.limit_verdicts group by metric, subject
)
select row_number() over worst as place, c.metric, c.subject, coalesce(n.en, c.metric) as en, coalesce(n.zh, c.metric) as zh,
  c.failed, c.marginal, c.judged,
  c.failed / sum(c.failed) over () as share,
  sum(c.failed) over worst / sum(c.failed) over () as cumulative_share
from counted c left join metric_names n using (metric)
where c.failed > 0
window worst as (order by c.failed desc, c.marginal desc, c.metric, c.subject rows unbounded preceding)
order by place;
comment on view failure_pareto is 'which limits units fail by, the most frequent first';
