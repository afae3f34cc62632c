-- The last estimated Allan deviation of a signal in each run: from adev('FOG-0231', 'rate'). It is that of live data,
-- with strides; `gyrofleet allan` takes every window of the record, which differs by about 1 %, more at the longest times.
create or replace macro adev(wanted_unit, wanted_signal) as table
select run, tau_s, value, lo, hi, unit_of_measure, edf, n, "time", final, 'strided' as overlap
from estimates
where unit = wanted_unit and signal = wanted_signal and estimator = 'allan_deviation' and reason is null
qualify t_ns = max(t_ns) over (partition by run)
order by run, tau_s;
