-- Steps of gyro outputs with `deg_per_h`, which turns the output into deg/h of the input: by the scale factor that was last
-- valid before the step ended, also where the output is a rate already; else by the output's unit where that is an
-- angular rate, else by the nominal scale factor of the product. `scale_source` says which. Counts may be counts of a
-- sample, whose scale factor is proportional to the interval: `scale_remark` where that differs.
create or replace table internal.count_intervals as
select unit, signal, run, arg_min(dt_ns, t_first_ns) / 1e9 as interval_s
from internal.lake_channels where unit_of_measure in ('count', '1') and dt_ns > 0 group by unit, signal, run;

create or replace view rate_steps as
select g.* exclude (output_unit),
  coalesce(coalesce(g.rate_factor, 3600) / f.value, g.rate_factor, 3600 / p.scale_factor) as deg_per_h,
  case
    when f.value is not null then 'measured in run ' || f.run
    when g.rate_factor is not null then 'output is a rate'
    when p.scale_factor is not null then 'nominal of product ' || g.product
  end as scale_source,
  case when i.interval_s / c.interval_s not between 0.99 and 1.01 then
    format('the scale factor was measured with samples of {:.4g} s, these are of {:.4g} s: right only if a count is no '
      || 'increment over a sample', i.interval_s, c.interval_s) end as scale_remark
from internal.gyro_steps g
asof left join internal.scale_factors f
  on f.unit = g.unit and f.signal = g.signal and f.output_unit = g.output_unit and f.t_to_ns <= g.t_to_ns
left join internal.product_scales p on p.unit = g.unit and p.run = g.run and p.unit_of_measure = g.unit_of_measure
left join internal.count_intervals i on i.run = f.run and i.unit = f.unit and i.signal = f.signal
left join internal.count_intervals c on f.run is not null and c.run = g.run and c.unit = g.unit and c.signal = g.signal;
