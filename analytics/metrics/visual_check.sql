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
-- influence: none: a verdict has no uncertainty
-- of:        internal.entered_checks
select unit, signal, run, passed as value,
  null::double as standard_uncertainty, null::double as freedom, null::double as lo, null::double as hi,
  1 as n,
  {item: item, verdict: verdict, entered: entered, "by": by_whom, note: note, "at": entered_at} as parameters,
  runs, steps,
  case when passed is null then 'no verdict of PASS or FAIL was entered for ' || item end as reason
from internal.entered_checks
where is_visual
