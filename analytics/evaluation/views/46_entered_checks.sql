-- Checks that were entered by hand: one row for each entered record.
create or replace table internal.entered_checks as
with entered as (
  select *, document->>'$.item' as item, document->>'$.verdict' as verdict, nullif(run, '') as in_run
  from internal.standing_checks
)
select unit, null as signal, in_run as run, item, verdict,
  document->>'$.value' as entered, try_cast(document->>'$.value' as double) as number,
  nullif(document->>'$.unit_of_measure', '') as unit_of_measure,
  (document->>'$.lower')::double as lower_limit, (document->>'$.upper')::double as upper_limit,
  document->>'$.by' as by_whom, document->>'$.note' as note,
  strftime(make_timestamp_ns(t_ns)::timestamp, '%Y-%m-%dT%H:%M:%SZ') as entered_at,
  case verdict when 'PASS' then 1.0::double when 'FAIL' then 0.0::double end as passed,
  case when in_run is not null then [in_run] else [] end as runs, []::bigint[] as steps,
  regexp_matches(lower(item), '^visual|外观') as is_visual
from entered;
