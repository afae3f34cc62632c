-- Names that are probably one unit: alike but for letter case, spaces, hyphens, dots and underscores. And units of which
-- the last run has an output that nothing judges, beside others that are judged.
create or replace view unit_warnings as
with named as (
  select unit, lower(regexp_replace(unit, '[\s._-]', '', 'g')) as serial
  from (select unit from unit_runs union select unit from unit_metrics
    union select unit from internal.lake_channels union select unit from internal.lake_documents where unit is not null)
), alike as (
  select serial, list(unit order by unit) as names from named group by serial having count(*) > 1
)
select n.unit, list_filter(a.names, lambda name: name <> n.unit) as others,
  'probably one unit under ' || len(a.names) || ' names (' || array_to_string(a.names, ', ')
    || '): its metrics and verdicts are computed apart; import or run it under one name' as reason,
  '可能是同一产品的 ' || len(a.names) || ' 个编号（' || array_to_string(a.names, '、') || '）：指标与判定按不同产品分别计算，请统一编号' as reason_zh
from named n join alike a using (serial)
union all
select l.unit, [],
  'its last run, ' || l.run || ', has no completed step: nothing above is of it; import it again with --procedure and --position',
  '最近一次试验 ' || l.run || ' 没有已完成的步骤：以上结果均不含该次试验，请以 --procedure 和 --position 重新导入'
from (
  select c.unit, arg_max(c.run, c.arrival_first_ns) as run
  from internal.lake_channels c left join internal.rate_units r using (unit_of_measure)
  where is_output_name(c.signal) or (r.deg_per_h is not null and not is_instrument_name(c.signal))
  group by c.unit
) l join runs on runs.run = l.run and runs.outcome <> 'open'
semi join unit_runs judged on judged.unit = l.unit
anti join unit_runs of_run on of_run.unit = l.unit and of_run.run = l.run
order by 1;
comment on view unit_warnings is 'units that probably go by two names, and units whose last run nothing judges';
