-- The last fit of each finished run.
create or replace table internal.fitted_noise as
select run, unit, signal, arg_max(document, t_ns) as document from events where kind = 'NoiseFitted' group by all;
