-- Steps for the angle random walk by normalised bias stability, which are short.
create or replace view internal.random_walk_steps as
select s.unit, s.signal, s.run, [s.run] as runs, [s."index"] as steps, s.n, 'GJB2426A' as standard,
  '5.12.5.4.1 (23)(24)' as clause, s.t_from_ns, s.t_to_ns, abs(s.deg_per_h) as deg_per_h, g.sample_interval_s, s.is_no_noise,
  {
    method: 'normalised', duration_s: round_even(s.duration_s, 0)::bigint, sample_interval_s: g.sample_interval_s,
    remark: remark_on_samples(s.n, s.still, s.sd, s.outliers, s.outlier_excess, s.piled, s.piled_at, s.repeated, s.unit_of_measure)
  } as parameters,
  case when s.n = 0 then 'no sample in the evaluated part of the step'
    when s.deg_per_h is null then no_scale_factor(s.unit_of_measure)
    when g.irregular then 'the samples lie on no grid, and means over 1 s of the normalised method need one'
  end as reason
from internal.still_steps s join signals g on g.run = s.run and g.unit = s.unit and g.signal = s.signal
where regexp_matches(s."procedure", '^random_walk|随机游走');
