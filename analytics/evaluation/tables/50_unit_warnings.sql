-- Names that are probably one unit: alike but for letter case, spaces, hyphens, dots and underscores. And units of which
-- the last run has an output that nothing judges, beside others that are judged. And units with a record that stands
-- under another name, or in another step of its run, as well: as many samples of one output with the same mean and
-- standard deviation to nine digits. And units of which people have excluded runs.
-- And units of which runs are of another product than the last one, for which there are no limits. And units whose
-- sensitivity to temperature was measured over a narrower range, by 5 degC or more, than that of half of the units of
-- their product.

-- The temperatures over which each unit's sensitivities to temperature were measured, all tests together.
create or replace view internal.temperature_ranges as
select m.unit, m.metric, p.product, min(t.temperature) as lowest, max(t.temperature) as highest
from (
  select unit, signal, metric, coalesce(run, runs[1]) as run, unnest(steps) as step from unit_metrics
  where value is not null and len(runs) = 1 and parameters->>'$.room_temperature_deg_c' is not null
) m
join step_means t  -- not static_steps, for which the lines of all scale factors would be planned
  on t.unit = m.unit and t.signal = m.signal and t.run = m.run and t."index" = m.step and t.temperature is not null
join (select unit, arg_max(product, t_start_ns) as product from unit_runs where product is not null group by unit) p
  on p.unit = m.unit
group by m.unit, m.metric, p.product;

-- What it asks for more than once is planned once, and so is all of it: a view is planned when it is made as well.
create or replace table unit_warnings as
with each_run as materialized (
  from unit_runs
), excluded as materialized (
  from exclusions
), range as materialized (
  from internal.temperature_ranges
), last_product as materialized (
  select unit, arg_max(product, t_start_ns) as product from each_run where product is not null group by unit
), copied as (
  select signal, list(distinct {unit: unit, run: run} order by {unit: unit, run: run}) as records,
    list(distinct {unit: unit, run: run, step: "index"} order by {unit: unit, run: run, step: "index"}) as steps
  from step_means left join internal.rate_units r using (unit_of_measure)
  where n >= 30 and sd > 0
    and (is_output_name(signal) or (r.deg_per_h is not null and not is_instrument_name(signal)))
  group by signal, n, printf('%.9g %.9g', mean * coalesce(r.deg_per_h, 1), sd * coalesce(r.deg_per_h, 1))
  having count(*) > 1
), within as (
  select record.unit, record.run, count(*) as copies, list(record.step order by record.step) as steps
  from (select row_number() over () as record_id, steps from copied), unnest(steps) each_step(record)
  group by record_id, record.unit, record.run having count(*) > 1
), within_runs as (
  select unit, count(distinct run) as runs, arg_min(run, run) as run, arg_min(steps, (run, steps)) as steps
  from within group by unit
), copy as (
  select distinct own.record as own, other.record as other
  from copied, unnest(records) own(record), unnest(records) other(record) where own.record <> other.record
), copies as (
  select own.unit as unit, count(distinct own.run) as runs, list(distinct other.unit order by other.unit) as others,
    arg_min({own: own.run, unit: other.unit, run: other.run}, (own.run, other.unit, other.run)) as first
  from copy group by own.unit
), named as (
  select unit, lower(regexp_replace(unit, '[\s._-]', '', 'g')) as serial
  from (select unit from each_run union select unit from unit_metrics
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
select x.unit, [],
  count(*) || ' of its ' || any_value(r.runs) || if(any_value(r.runs) = 1, ' run', ' runs') || ' excluded from evaluation: '
    || array_to_string(list(x.run || ' (' || x.reason || '; ' || x.by_whom || ')' order by x.run)[:4], ', ')
    || if(count(*) > 4, ', ...', '') || ': nothing above is of ' || if(count(*) = 1, 'it', 'them'),
  any_value(r.runs) || ' 次试验中有 ' || count(*) || ' 次已排除，不参与评定：'
    || array_to_string(list(x.run || '（' || x.reason || '；' || x.by_whom || '）' order by x.run)[:4], '、')
    || if(count(*) > 4, '等', '') || '；以上结果均不含这些试验'
from excluded x
join (
  select unit, count(distinct run) as runs from internal.lake_documents
  where kind in ('StepStarted', 'UnitMounted') group by unit
) r using (unit)
group by x.unit
union all
select unit, list_filter(others, lambda name: name <> unit),
  'has ' || runs || if(runs = 1, ' run', ' runs') || ' with the samples of another one (run ' || first.own || ' is run '
    || first.run || ' of ' || first.unit || '): one measurement under several names counts several times in verdicts and '
    || 'trends',
  '有 ' || runs || ' 次试验与另一次采样相同（试验 ' || first.own || ' 即产品 ' || first.unit || ' 的试验 ' || first.run
    || '）：同一测量记在多个名下，在判定与趋势中重复计入'
from copies
union all
select unit, [],
  'has the same samples in several steps of ' || if(runs = 1, 'run ', runs || ' runs, as in run ') || run || ' (steps '
    || array_to_string(steps[:4], ', ') || if(len(steps) > 4, ', ...', '') || '): one measurement counts several times in its '
    || 'values; the file was probably imported at two times',
  '在' || if(runs = 1, '试验 ', ' ' || runs || ' 次试验中，如试验 ') || run || ' 的多个步骤（'
    || array_to_string(steps[:4], '、') || if(len(steps) > 4, '等', '') || '）中采样相同：同一测量重复计入其结果，文件可能以两个时间导入过'
from within_runs
union all
select l.unit, [],
  'its last run, ' || l.run || ', has no completed step: nothing above is of it; ' || if(ended.outcome = 'completed',
    'import it again with --procedure and --position',
    'it ended as ' || ended.outcome || ': measure again, or exclude it (`gyrofleet runs exclude`)'),
  '最近一次试验 ' || l.run || ' 没有已完成的步骤：以上结果均不含该次试验，' || if(ended.outcome = 'completed',
    '请以 --procedure 和 --position 重新导入', '该试验未正常完成，请重新试验或排除（`gyrofleet runs exclude`）')
from (
  select c.unit, arg_max(c.run, c.arrival_first_ns) as run
  from internal.lake_channels c left join internal.rate_units r using (unit_of_measure)
  where is_output_name(c.signal) or (r.deg_per_h is not null and not is_instrument_name(c.signal))
  group by c.unit
) l join internal.ended_runs ended on ended.run = l.run
semi join each_run judged on judged.unit = l.unit
anti join excluded x on x.unit = l.unit and x.run = l.run
anti join each_run of_run on of_run.unit = l.unit and of_run.run = l.run
union all
select unit, [],
  len(runs) || if(len(runs) = 1, ' run', ' runs') || ' (' || array_to_string(runs[:4], ', ') || if(len(runs) > 4, ', ...', '')
    || ') of product ' || product || ', for which there are no limits: none of it is judged; where it is not its product, '
    || 'correct it with `gyrofleet import --units`',
  '有 ' || len(runs) || ' 次试验（' || array_to_string(runs[:4], '、') || if(len(runs) > 4, '等', '') || '）的产品型号为 '
    || product || '，该型号没有限值：这些试验均未判定；若型号有误，请用 `gyrofleet import --units` 更正'
from (
  select r.unit, r.product, list(distinct r.run order by r.run) as runs
  from each_run r join last_product last on last.unit = r.unit and last.product <> r.product
  where not exists (from internal.limit_editions e where e.product is null or e.product = r.product)
    and exists (from internal.limit_editions e where e.product = last.product)
  group by r.unit, r.product
)
union all
select r.unit, [],
  n.en || ' was measured from ' || printf('%.3g to %.3g', r.lowest, r.highest) || ' degC; of the '
    || u.units || ' units of product ' || r.product || ' half reach ' || printf('%.3g and half %.3g', u.lowest, u.highest)
    || ' degC: it says nothing of the rest',
  n.zh || '的测量温度范围为 ' || printf('%.3g 至 %.3g', r.lowest, r.highest) || ' ℃，' || r.product || ' 型 ' || u.units
    || ' 个产品的中位范围为 ' || printf('%.3g 至 %.3g', u.lowest, u.highest) || ' ℃：结果不涵盖其余温度'
from range r
join (
  select product, metric, count(*) as units, median(lowest) as lowest, median(highest) as highest
  from range group by product, metric having count(*) >= 4
) u using (product, metric)
join metric_names n using (metric)
where r.highest <= u.highest - 5 or r.lowest >= u.lowest + 5
order by 1;
comment on table unit_warnings is 'units that probably go by two names, units with copied records, with excluded runs, units whose last run nothing judges, and units measured over fewer temperatures than others of their product';
