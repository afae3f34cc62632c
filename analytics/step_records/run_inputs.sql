-- What the records of each run with a completed step that is not excluded depend on: its samples and its documents.
with sampled as (
  select run, string_agg(
      concat_ws('|', channel, samples, kept_raw, t_first_ns, t_last_ns), ';' order by channel) as samples
  from internal.lake_channels group by run
), excluded as (
  select (run, unit) as of_unit from exclusions
), documented as (
  select run, bit_xor(hash(uid)) as documents, count(*) as n,
    count(*) filter (kind = 'StepEnded' and (run, unit) not in (select of_unit from excluded)) as steps
  from internal.lake_documents where kind not in ('EstimatePublished', 'EarlyDecision') group by run
)
select run, samples, documents::varchar, n from documented join sampled using (run) where steps > 0 order by run
