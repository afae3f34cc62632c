-- Risks of deciding wrongly, of each limit over each lot, by the rule that its values were judged with (JCGM 106:2012 9).
-- A specific risk is that of one unit, the largest is given; a global one is the share of all judged units that is
-- expected to be accepted and not conforming, or rejected and conforming. Units of verdict MARGINAL are neither. A unit with
-- several values, as of two standards or measured again, counts once, by the worst of them.
create or replace view conformity_risks as
with of_units as (
  select lot, metric, subject, specification, revision, decision_rule, unit, conformity_of,
    case when bool_or(verdict = 'FAIL') then 'FAIL' when bool_or(verdict = 'MARGINAL') then 'MARGINAL' else 'PASS' end
      as verdict,
    coalesce(min(conformity) filter (verdict = 'FAIL'), min(conformity)) as conformity
  from (
    select * replace (if(bool_and(conformity_of = 'U') over (partition by lot, metric, subject, specification, revision,
      decision_rule, unit), 'U', 'type A only') as conformity_of)
    from verdicts where conformity is not null and verdict <> 'NO_DATA'  -- a rule that lacks its U accepts nothing
  )
  group by all
)
select lot, metric, subject, specification, revision, decision_rule,
  count(*) as judged,
  count(*) filter (verdict = 'PASS') as accepted,
  count(*) filter (verdict = 'FAIL') as rejected,
  count(*) filter (verdict = 'MARGINAL') as undecided,
  max(1 - conformity) filter (verdict = 'PASS') as specific_consumer_risk,
  max(conformity) filter (verdict = 'FAIL') as specific_producer_risk,
  coalesce(sum(1 - conformity) filter (verdict = 'PASS'), 0) / count(*) as global_consumer_risk,
  coalesce(sum(conformity) filter (verdict = 'FAIL'), 0) / count(*) as global_producer_risk,
  if(bool_and(conformity_of = 'U'), 'U', 'type A only') as conformity_of
from of_units
group by all;
comment on view conformity_risks is 'consumer''s and producer''s risk of each limit over each lot, by its decision rule';
