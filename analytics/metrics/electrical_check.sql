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
-- influence: none: the instrument of an entered check is not one of the station
-- of:        internal.entered_checks
select unit, signal, run, coalesce(number, passed) as value,
  case when number is not null then unit_of_measure end as unit_of_measure,
  null::double as standard_uncertainty, null::double as freedom, null::double as lo, null::double as hi,
  1 as n,
  {
    item: item, verdict: verdict, lower: lower_limit, upper: upper_limit, "by": by_whom, note: note, "at": entered_at
  } as parameters,
  runs, steps,
  case when number is null and passed is null then
    'neither a value nor a verdict of PASS or FAIL was entered for ' || item end as reason
from internal.entered_checks
where not is_visual
