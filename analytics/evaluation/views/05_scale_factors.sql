-- The scale factors that metrics may use; empty until the evaluation has them.
create or replace table internal.scale_factors (
  unit varchar, signal varchar, run varchar, output_unit varchar, value double, t_to_ns bigint
);
