-- id:        output_delay
-- en:        Output delay time
-- zh:        输出延迟时间
-- unit:      ms
-- better:    nearer_zero
-- grain:     unit, signal, run
-- parameters: bandwidth_hz, misfit_rad, position, axis, reference, frequencies, records, sample_rate_hz
-- source:    GJB 2426A-2004 5.14 (42)-(46); JJF 2014-2022 7.2.22 (44)-(50)
-- needs:     procedure bandwidth, with the table's rate or angle recorded as fast as the units
-- limits:    t
-- equation:  -P_i - atan(omega_i T) = omega_i T_d
-- influence: clock: per_ppm(value)
-- influence: clock_delay: 1000
-- python:    analytics.metrics.angular_vibration:output_delays
-- of:        step_means where frequency > 0
from internal.vibration_steps
order by run, unit, signal, "procedure", position, axis, t_from_ns, "index"
