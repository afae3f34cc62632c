-- What `gyrofleet sql --tables` tells.
comment on view samples is 'every sample: value in its unit_of_measure, counts where the device gives counts';
comment on view signals is 'one row for each signal of each unit and run: how much there is, from when to when';
comment on view runs is 'one row for each run: procedure, lot, operator, when, outcome';
comment on view units is 'which units a run has tested: product, lot, slot, fixture, firmware';
comment on view steps is 'what was commanded: one row for each step of each unit';
comment on view estimates is 'what the estimators said while the data flowed, with confidence limits';
comment on view events is 'every document: power-ons, notes, limits, verdicts, fits; its content as JSON';
comment on view rollup_1s is 'count, mean, deviation, least and greatest value of each second';
comment on view rollup_10s is 'count, mean, deviation, least and greatest value of each ten seconds';
comment on view clocks is 'the clock of each source against the recorder: drift, jumps';
