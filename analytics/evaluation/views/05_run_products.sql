-- The numbers of each unit's product in each of its runs: those of the specification that was valid when the run began,
-- as that was known when the run was recorded; where nothing was known then, as it was first known. Without one that was
-- valid, the one that is nearest in time counts.
create or replace table internal.run_products as
with run as (
  select unit, run, min(product) as product, bool_and(date_known) as date_known, min(t_start_ns) as t_ns
  from step_means where product is not null group by unit, run
), recorded as (
  select unit, run, min(arrival_first_ns) as recorded_ns from internal.lake_channels group by unit, run
), placed as (
  select r.unit, r.run, r.product, coalesce(c.recorded_ns, 9223372036854775806) as recorded_ns,
    case when r.date_known then r.t_ns else coalesce(c.recorded_ns, 9223372036854775806) end as t_ns
  from run r left join recorded c using (unit, run)
), known as (
  select p.unit, p.run, p.product, p.t_ns, min(greatest(e.known_from_ns, p.recorded_ns)) as known_ns
  from placed p join internal.product_editions e on e.product = p.product and e.known_until_ns > p.recorded_ns
  group by all
)
select k.unit, k.run, e.* exclude (specification, from_ns, known_from_ns, known_until_ns)
from known k
join internal.product_editions e on e.product = k.product and e.known_from_ns <= k.known_ns and k.known_ns < e.known_until_ns
qualify row_number() over (
  partition by k.unit, k.run
  order by e.from_ns <= k.t_ns desc, abs(k.t_ns::hugeint - e.from_ns::hugeint), e.specification
) = 1;

create or replace view internal.product_scales as
select unit, run, product,
  -- two names of one unit
  unnest(if(scale_factor_unit in ('count', 'LSB'), ['count', 'LSB'], [scale_factor_unit])) as unit_of_measure,
  scale_factor
from internal.run_products where scale_factor is not null;
