-- What the records of each run with a completed step depend on: its samples and its documents.
with sampled as (
  select run, string_agg(
      concat_ws('|', channel, samples, kept_raw, t_first_ns, t_last_ns), ';' order by channel) as samples
  from internal.lake_channels group by run
), documented as (
  select run, bit_xor(hash(uid)) as documents, count(*) as n,
    count(*) filter (kind = 'StepEnded') as steps
  from internal.lake_documents where kind not in ('EstimatePublished', 'EarlyDecision') group by run
)
select run, samples, documents::varchar, n from documented join sampled using (run) where steps > 0 order by run
