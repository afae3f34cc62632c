-- id:        angle_random_walk
-- en:        Angle random walk
-- zh:        角度随机游走系数
-- unit:      deg/sqrt(h)
-- better:    lower
-- grain:     unit, signal, run, step, method
-- parameters: method, duration_s, whole_seconds, record, sample_interval_s, remark
-- source:    GJB 2426A-2004 5.12.5.4 (23)-(31); JJF 2014-2022 7.2.20 (34)-(39)
-- needs:     a static step, one hour long as a rule; for the normalised method one of procedure random_walk
-- limits:    given
-- equation:  RWC = sqrt(A_-1), sigma^2(tau) = sum A_m tau^m; normalised RWC = Bs(1 s) sqrt(1 s)
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: clock: per_ppm(value) / 2
-- python:    analytics.metrics.angle_random_walk:compute
-- of:        internal.still_steps
-- The fit of the whole run's Allan curve, else the white part of the step's own curve, whose bounds are added below.
select s.unit, s.signal, s.run, s.n, [s.run] as runs, [s."index"] as steps,
  case when s.lack is null then
    case when c.run is not null then c.value else sqrt(nullif(s.white, 0)) * abs(s.deg_per_h) / 60 end end as value,
  c.lo, c.hi, c.standard_uncertainty,
  -- the shortest averaging times determine white noise; long steps and irregular ones are reduced from means of 1 s
  case when c.run is null then greatest(coalesce(s.whole_seconds, case when s.n > 20000 then s.duration_s else s.n end) / 1.5, 1) end
    as freedom,
  to_json({
    method: 'allan', duration_s: round(s.duration_s),
    whole_seconds: case when s.whole_seconds < s.duration_s then s.whole_seconds end, record: case when c.run is not null then 'run' else 'step' end,
    remark: nullif(concat_ws('; ', c.misfit_remark, s.remark), '')
  })::varchar as parameters,
  case when s.lack is not null then s.lack when c.run is not null then c.reason when coalesce(s.white, 0) = 0 then
    'the record shows no white noise, from which an angle random walk follows: correlated or other noise covers it' end as reason
from internal.bias_steps s
left join internal.noise_coefficients c
  on c.run = s.run and c.unit = s.unit and c.signal = s.signal and c."index" = s."index"
  and c.coefficient = 'angle_random_walk' and (c.value is not null or s.white is null)
order by s.unit, s.signal, s.run, s."index"
