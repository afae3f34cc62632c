-- Steps of gyro outputs. `deg_per_h` turns the output into deg/h: by its unit where that is an angular rate, else by the
-- scale factor that was last valid before the step ended, else by the nominal one of the product; `scale_source` says which.
create or replace view gyro_steps as
select s.*, r.deg_per_h as rate_factor
from step_means s left join rate_units r using (unit_of_measure)
where regexp_matches(s.signal, '^rate(_|$)')
  or (r.deg_per_h is not null and not regexp_matches(s.signal, '^(table|input|chamber)'));

create or replace view rate_steps as
select g.*,
  coalesce(g.rate_factor, 3600 / f.value, 3600 / p.scale_factor) as deg_per_h,
  case
    when g.rate_factor is not null then 'output is a rate'
    when f.value is not null then 'measured in run ' || f.run
    when p.scale_factor is not null then 'nominal of product ' || g.product
  end as scale_source
from gyro_steps g
asof left join scale_factors f
  on f.unit = g.unit and f.signal = g.signal and f.t_to_ns <= g.t_to_ns
left join product_scales p on p.product = g.product and p.unit_of_measure = g.unit_of_measure;
