-- The tables of 13_scale_fits.sql and 14_measured_scale_factors.sql where no rate was measured, as on every static
-- bench: planning the lines takes longer than all else of a small store. A test compares the columns.

create or replace table internal.scale_fits (
  "run" varchar, "unit" varchar, "signal" varchar, "procedure" varchar, "repeat" bigint, "temperature_command"
  double, "room" boolean, "position" varchar, "axis" varchar, "phase" varchar, "visit" bigint, "output_unit" varchar, "product"
  varchar, "station" varchar, "time_zone" varchar, "date_known" boolean, "t_from_ns" bigint, "t_to_ns" bigint,
  "rests" struct("index" bigint, output double, u double, freedom double)[], "n" bigint, "forwards" double[],
  "backwards" double[], "rest_before" struct("index" bigint, output double, u double, freedom double), "rest_after"
  struct("index" bigint, output double, u double, freedom double), "largest_rate" double, "temperature" double,
  "steps" bigint[], "max_rate_deg_per_s" double, "nonlinearity_ppm" double, "points" struct("index" bigint, command
  double, rate double, output double, u double, freedom double, temperature double, stands_still boolean, lasts_s double)[], "x" double[],
  "y" double[], "u" double[], "freedoms" double[], "n_points" bigint, "x_mean" double, "y_mean" double, "dx"
  double[], "dy" double[], "sxx" double, "slope_weights" double[], "k" double, "zero" double, "residuals" double[],
  "zero_weights" double[], "u_k" double, "freedom_k" double, "plus" struct(k double, u_k double, freedom_k double,
  residuals double[], sxx double, n_points bigint, points struct("index" bigint, command double, rate double, output
  double, u double, freedom double, temperature double, stands_still boolean, lasts_s double)[], slope_weights double[], u double[],
  freedoms double[]), "minus" struct(k double, u_k double, freedom_k double, residuals double[], sxx double,
  n_points bigint, points struct("index" bigint, command double, rate double, output double, u double, freedom
  double, temperature double, stands_still boolean, lasts_s double)[], slope_weights double[], u double[], freedoms double[]), "rest_zero"
  double, "k_unit" varchar, "lack_of_answer" varchar, "remark_on_range" varchar, "remark_on_points" varchar, "gjb_directions" varchar, "jjf_directions" varchar,
  "lack_of_range" varchar, "lack_of_rest" varchar, "jjf1536_lack" varchar, "jjf1536_remark" varchar, "gjb_reason"
  varchar, "jjf_reason" varchar, "jjf1536_reason" varchar, "words" struct("procedure" varchar, repeat bigint,
  temperature_command double, room boolean, "position" varchar, axis varchar, phase varchar, visit bigint)
);
