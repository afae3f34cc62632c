-- Buckets of 1 s and 10 s of the source's clock. Buckets shared by segments are merged by the formula of Chan, Golub and
-- LeVeque, from the sums of squares and the means. In tidy signals only edges can be shared; other buckets are final.
create or replace macro internal.rollups_in(paths) as table
select 1 as seconds, * from internal.lake_rollup_1s where paths is null or list_contains(paths, filename)
union all
select 10 as seconds, * from internal.lake_rollup_10s where paths is null or list_contains(paths, filename);

create or replace macro internal.buckets_in(paths) as table
with shared as (
  select r.seconds, c.unit, c.signal, c.run, c.unit_of_measure, r.bucket, r.n, r.mean, r.m2, r.lo, r.hi,
    sum(r.n) over same as n_all,
    -- in a fixed order, so that the result is bit-identical
    sum(r.n * r.mean) over (same order by r.n, r.mean, r.m2 rows between unbounded preceding and unbounded following)
      / sum(r.n) over same as mean_all
  from internal.rollups_in(paths) r join internal.lake_channels c using (channel)
  where r.edge or not c.is_tidy
  window same as (partition by r.seconds, c.unit, c.signal, c.run, c.unit_of_measure, r.bucket)
)
select r.seconds, c.unit, c.signal, c.run, r.bucket, r.n, r.mean, r.m2, r.lo, r.hi, c.unit_of_measure
from internal.rollups_in(paths) r join internal.lake_channels c using (channel)
where not r.edge and c.is_tidy
union all
select seconds, unit, signal, run, bucket, sum(n)::bigint as n,
  case when count(*) = 1 then any_value(mean) else any_value(mean_all) end as mean,
  sum(m2 + n * (mean - mean_all) ** 2 order by n, mean, m2) as m2,
  min(lo) as lo, max(hi) as hi, unit_of_measure
from shared
group by seconds, unit, signal, run, unit_of_measure, bucket;

create or replace macro internal.rollup_1s_in(paths) as table
select unit, signal, run, make_timestamp_ns(bucket * 1000000000) as "time", bucket * 1000000000 as t_ns, n, mean,
  case when n > 1 then sqrt(m2 / (n - 1)) end as stddev, m2, lo, hi, unit_of_measure
from internal.buckets_in(paths) where seconds = 1;

create or replace view rollup_1s as from internal.rollup_1s_in(null);

create or replace macro internal.rollup_10s_in(paths) as table
select unit, signal, run, make_timestamp_ns(bucket * 10000000000) as "time", bucket * 10000000000 as t_ns, n, mean,
  case when n > 1 then sqrt(m2 / (n - 1)) end as stddev, m2, lo, hi, unit_of_measure
from internal.buckets_in(paths) where seconds = 10;

create or replace view rollup_10s as from internal.rollup_10s_in(null);
