-- Steps of gyro outputs. `deg_per_h` turns the output into deg/h of the input: by the scale factor that was last valid
-- before the step ended, also where the output is a rate already; else by the output's unit where that is an angular
-- rate, else by the nominal scale factor of the product. `scale_source` says which. `output_unit` is what scale factors
-- are in: deg/s for all rates. A rate that is given or measured by another instrument is no gyro's output.
create or replace macro is_instrument_name(signal) as
  regexp_matches(lower(signal), '^(table|input|chamber|command|set_?point|vibration|stage|platform|encoder|earth)'
    '|^(reference|ref|true|truth)(_|$)|^rate_(table|input|command|set_?point|reference|ref|true|truth)$');

create or replace macro is_output_name(signal) as
  (regexp_matches(signal, '^rate(_|$)') or is_integrated_output(signal)) and not is_instrument_name(signal);

create or replace macro no_scale_factor(unit_of_measure) as
  'no scale factor for an output in ' || unit_of_measure || ': measure it or give the nominal one of the product';

create or replace view internal.gyro_steps as
select s.*, r.deg_per_h as rate_factor,
  case when r.deg_per_h is null then s.unit_of_measure else 'deg/s' end as output_unit
from step_means s left join internal.rate_units r using (unit_of_measure)
where is_output_name(s.signal) or (r.deg_per_h is not null and not is_instrument_name(s.signal));

create or replace view rate_steps as
select g.* exclude (output_unit),
  coalesce(coalesce(g.rate_factor, 3600) / f.value, g.rate_factor, 3600 / p.scale_factor) as deg_per_h,
  case
    when f.value is not null then 'measured in run ' || f.run
    when g.rate_factor is not null then 'output is a rate'
    when p.scale_factor is not null then 'nominal of product ' || g.product
  end as scale_source
from internal.gyro_steps g
asof left join internal.scale_factors f
  on f.unit = g.unit and f.signal = g.signal and f.output_unit = g.output_unit and f.t_to_ns <= g.t_to_ns
left join internal.product_scales p on p.unit = g.unit and p.run = g.run and p.unit_of_measure = g.unit_of_measure;
