-- id:        electrical_check
-- en:        Electrical check
-- zh:        电气检查
-- unit:      1
-- better:    neither
-- grain:     unit, entered record
-- parameters: item, verdict, lower, upper, by, note, at
-- source:    GJB 2426A-2004 5.3
-- needs:     entered checks of other items than visual: insulation_resistance, impedance, dielectric_strength
-- limits:    given
-- equation:  the value that was entered, in its unit; without one 1 for PASS and 0 for FAIL
with entered as (
  select unit, run, t_ns, document->>'$.item' as item, document->>'$.verdict' as verdict,
    try_cast(document->>'$.value' as double) as value, nullif(document->>'$.unit_of_measure', '') as unit_of_measure,
    (document->>'$.lower')::double as lower_limit, (document->>'$.upper')::double as upper_limit,
    document->>'$.by' as by_whom, document->>'$.note' as note
  from events where kind = 'CheckEntered'
)
select unit, null as signal, nullif(run, '') as run,
  coalesce(value, case verdict when 'PASS' then 1.0::double when 'FAIL' then 0.0::double end) as value,
  case when value is not null then unit_of_measure end as unit_of_measure,
  null::double as standard_uncertainty, null::double as freedom, null::double as lo, null::double as hi,
  1 as n,
  {
    item: item, verdict: verdict, lower: lower_limit, upper: upper_limit, "by": by_whom, note: note,
    "at": strftime(make_timestamp_ns(t_ns)::timestamp, '%Y-%m-%dT%H:%M:%SZ')
  } as parameters,
  case when run <> '' then [run] else [] end as runs, []::bigint[] as steps,
  case when value is null and (verdict is null or verdict not in ('PASS', 'FAIL')) then
    'neither a value nor a verdict of PASS or FAIL was entered for ' || item end as reason
from entered
where not regexp_matches(lower(item), '^visual|外观')
