-- id:        bandwidth
-- en:        Bandwidth
-- zh:        频带宽度
-- unit:      Hz
-- better:    higher
-- grain:     unit, signal, run
-- parameters: method, gain_1, misfit, position, axis, reference, frequencies, records, sample_rate_hz
-- source:    GJB 2426A-2004 5.13 (35)-(41); JJF 2014-2022 7.2.21 (40)-(43)
-- needs:     procedure bandwidth: 10 frequencies in equal ratios from 10 Hz to 2 bandwidths, sampled above 20 of them
-- limits:    t
-- equation:  G^2 = K_D^2 - T^2 omega^2 G^2, Bw = 1/(2 pi T); or where the gain is 0.707
-- influence: vibration_rate: 2 * per_ppm(value)
-- influence: clock: per_ppm(value)
-- python:    analytics.metrics.angular_vibration:bandwidths
-- of:        step_means where frequency > 0
from internal.vibration_steps
order by run, unit, signal, "procedure", position, axis, t_from_ns, "index"
