-- Names that are probably one unit: alike but for letter case, spaces, hyphens, dots and underscores.
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
order by n.unit;
comment on view unit_warnings is 'units that probably go by two names';
