-- Base of the views. A channel is one signal of one epoch with one meaning (unit of measure, scale, offset). It may
-- extend over many segments of the log; here it becomes one row.
create or replace view internal.lake_channel_parts as
select *, true as is_kept from internal.lake_channels_kept
union all by name
select *, false as is_kept from internal.lake_channels_dropped;

-- A signal is tidy if its stretches follow each other in time: then only edges of stretches share a bucket.
create or replace table internal.lake_channels as
with stretch as (
  select *,
    overlapping or coalesce(t_first_ns < max(t_last_ns) over (
      partition by unit, signal, run order by t_first_ns, t_last_ns, channel
      rows between unbounded preceding and 1 preceding), false) as is_overlapping
  from internal.lake_channel_parts
), channel as (
  select
    channel,
    any_value(site) as site,
    any_value(station) as station,
    any_value(unit) as unit,
    any_value(signal) as signal,
    any_value(run) as run,
    any_value(epoch) as epoch,
    any_value(unit_of_measure) as unit_of_measure,
    any_value(is_counts) as is_counts,
    any_value(scale) as scale,
    any_value("offset") as "offset",
    min(dt_ns) as dt_ns,
    bool_or(irregular) as irregular,
    sum(samples)::bigint as samples,
    coalesce(sum(samples) filter (is_kept), 0)::bigint as kept_raw,
    coalesce(sum(samples) filter (filename is null), 0)::bigint as live,  -- of no file: only the log has them
    min(seq_first) as seq_first,
    max(seq_next) as seq_next,
    min(t_first_ns) as t_first_ns,
    max(t_last_ns) as t_last_ns,
    min(arrival_first_ns) as arrival_first_ns,
    max(arrival_last_ns) as arrival_last_ns,
    bool_or(is_overlapping) as is_overlapping
  from stretch
  group by channel
)
select * exclude (is_overlapping), not bool_or(is_overlapping) over (partition by unit, signal, run) as is_tidy
from channel;

-- A document that was sent twice counts once.
create or replace view internal.lake_documents as
select * from internal.lake_events
qualify row_number() over (partition by uid order by arrival_ns) = 1;
