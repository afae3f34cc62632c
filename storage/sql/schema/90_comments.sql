-- Comments for `gyrofleet sql --tables`.
comment on view samples is 'every sample: value in its unit_of_measure, counts where the device gives counts';
comment on view signals is 'one row for each signal of each unit and run: number of samples, time range';
comment on view runs is 'one row for each run: procedure, lot, operator, when, outcome';
comment on view units is 'the units tested in each run: product, lot, slot, fixture, firmware';
comment on view steps is 'commands: one row for each step of each unit';
comment on view estimates is 'estimates published during the run, with confidence bounds';
comment on view events is 'every document: power-ons, notes, limits, verdicts, fits; its content as JSON';
comment on view rollup_1s is 'count, mean, standard deviation, minimum and maximum of each second';
comment on view rollup_10s is 'count, mean, standard deviation, minimum and maximum of each ten seconds';
comment on view exclusions is 'units of runs that people have excluded from every evaluation, and why';
comment on view clocks is 'clock of each source relative to the recorder: drift, jumps';
