-- id:        allan_deviation
-- en:        Allan deviation
-- zh:        Allan 标准差
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, step, averaging time
-- parameters: tau_s, position, repeat, scale_factor, remark
-- source:    GJB 2426A-2004 5.12.5.4.2 (25)(26); JJF 2014-2022 7.2.20 (34)(35)
-- needs:     a static step (procedure static_bias or allan_variance), and a limit that names the averaging time
-- limits:    given
-- equation:  sigma^2(tau) = mean((F_(i+1) - F_i)^2)/2, F_i means over tau that overlap
-- influence: rate: per_ppm(value)
-- influence: voltage: per_ppm_of_voltage(value, volt)
-- influence: clock: per_ppm(value) / 2
-- python:    analytics.metrics.allan_deviation:compute
-- of:        internal.specification_parameters where metric = 'allan_deviation'
select s.unit, s.signal, s.run, s.n, ["index"] as steps, s.lack as reason, t.tau_s, s.t_from_ns, s.t_to_ns,
  s.duration_s, s.is_no_noise, s.deg_per_h, s.unit_of_measure as output_unit,
  {
    tau_s: t.tau_s, position: s.position, repeat: s.repeat, scale_factor: s.scale_source, remark: s.remark
  } as parameters
from internal.bias_steps s,
  (select distinct replace(key, 'number ', '')::double as tau_s from internal.specification_parameters
    where metric = 'allan_deviation' and path = '$."tau_s"' and starts_with(key, 'number ')) t
where t.tau_s > 0
order by s.unit, s.signal, s.run, s."index", t.tau_s
