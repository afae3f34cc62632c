comment on view step_means is 'one row for each signal of each completed step: mean, deviations of averages, uncertainty, in its unit_of_measure';
comment on view rate_steps is 'step_means of gyro outputs with deg_per_h, the factor into deg/h, and where it comes from';
comment on view static_steps is 'steps in which a unit stands still, in deg/h, with the Earth rate in them';
comment on view unit_metrics is 'every characteristic of every unit: value, limits, uncertainty, steps used, or the reason why there is none';
comment on view metric_names is 'every metric there is: names, unit of measure, standard, clause, equation, what it needs';
comment on view specification_limits is 'limits of the specifications that are in force, by revision and validity';
comment on view specification_history is 'who added, revised or withdrew which specification, when and why';
