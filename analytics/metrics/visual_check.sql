-- id:        visual_check
-- en:        Visual check
-- zh:        外观检查
-- unit:      1
-- better:    higher
-- grain:     unit, entered record
-- parameters: item, verdict, entered, by, note, at
-- source:    GJB 2426A-2004 5.2
-- needs:     an entered check (`gyrofleet check`) whose item begins with visual
-- limits:    given
-- equation:  1 where the verdict that was entered is PASS, 0 where it is FAIL
with entered as (
  select unit, run, t_ns, uid, document->>'$.item' as item, document->>'$.verdict' as verdict,
    document->>'$.value' as entered, document->>'$.by' as by_whom,
    document->>'$.note' as note
  from events where kind = 'CheckEntered'
)
select unit, null as signal, nullif(run, '') as run,
  case verdict when 'PASS' then 1.0::double when 'FAIL' then 0.0::double end as value,
  null::double as standard_uncertainty, null::double as freedom, null::double as lo, null::double as hi,
  1 as n,
  {
    item: item, verdict: verdict, entered: entered, "by": by_whom, note: note,
    "at": strftime(make_timestamp_ns(t_ns)::timestamp, '%Y-%m-%dT%H:%M:%SZ')
  } as parameters,
  case when run <> '' then [run] else [] end as runs, []::bigint[] as steps,
  case when verdict is null or verdict not in ('PASS', 'FAIL') then
    'no verdict of PASS or FAIL was entered for ' || item end as reason
from entered
where regexp_matches(lower(item), '^visual|外观')
