-- The table of 14_measured_scale_factors.sql where no rate was measured, see scale_fits.sql.

create or replace table internal.scale_factors (
  "unit" varchar, "signal" varchar, "run" varchar, "output_unit" varchar, "value" double, "t_to_ns" bigint
);
