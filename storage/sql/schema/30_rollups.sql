-- Buckets of 1 s and 10 s of the source's clock. Buckets shared by segments are merged by the formula of Chan, Golub and
-- LeVeque, from the sums of squares and the means. In tidy signals only edges can be shared; other buckets are final.
create or replace macro internal.buckets_in(rollup, paths) as table
with rows_of as (
  from query_table(rollup) where paths is null or list_contains(paths, filename)
), shared as (
  select c.unit, c.signal, c.run, c.unit_of_measure, r.bucket, sum(r.n)::bigint as n, min(r.lo) as lo, max(r.hi) as hi,
    list(struct_pack(n := r.n, mean := r.mean, m2 := r.m2)) as parts
  from rows_of r join internal.lake_channels c using (channel)
  where r.edge or not c.is_tidy
  group by all
), merged as (
  select *,
    -- in a fixed order, so that the result is bit-identical
    case when len(parts) = 1 then parts[1].mean
      else list_sum(list_transform(list_sort(parts), lambda part: part.n * part.mean)) / n end as mean
  from shared
)
select c.unit, c.signal, c.run, r.bucket, r.n, r.mean, r.m2, r.lo, r.hi, c.unit_of_measure
from rows_of r join internal.lake_channels c using (channel)
where not r.edge and c.is_tidy
union all
select unit, signal, run, bucket, n, mean,
  case when len(parts) = 1 then parts[1].m2
    else list_sum(list_transform(list_sort(parts), lambda part: part.m2 + part.n * (part.mean - mean) ** 2)) end as m2,
  lo, hi, unit_of_measure
from merged;

create or replace macro internal.rollup_1s_in(paths) as table
select unit, signal, run, make_timestamp_ns(bucket * 1000000000) as "time", bucket * 1000000000 as t_ns, n, mean,
  case when n > 1 then sqrt(m2 / (n - 1)) end as stddev, m2, lo, hi, unit_of_measure
from internal.buckets_in('internal.lake_rollup_1s', paths);

create or replace view rollup_1s as from internal.rollup_1s_in(null);

create or replace macro internal.rollup_10s_in(paths) as table
select unit, signal, run, make_timestamp_ns(bucket * 10000000000) as "time", bucket * 10000000000 as t_ns, n, mean,
  case when n > 1 then sqrt(m2 / (n - 1)) end as stddev, m2, lo, hi, unit_of_measure
from internal.buckets_in('internal.lake_rollup_10s', paths);

create or replace view rollup_10s as from internal.rollup_10s_in(null);
