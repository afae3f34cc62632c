-- Steps of gyro outputs. `output_unit` is what scale factors are in: deg/s for all rates. A rate that is given or
-- measured by another instrument is no gyro's output.
create or replace macro is_instrument_name(signal) as
  regexp_matches(lower(signal), '^(table|input|chamber|command|cmd|set_?point|target|demand|desired|vibration|stage'
    '|platform|encoder|earth|motor|spindle|soll|(dreh)?tisch|drehzahl|vorgabe|referenz|kammer|consigne|plateau)'
    '|^(reference|ref|true|truth)(_|$)'
    '|^rate_(table|input|command|set_?point|target|demand|desired|reference|ref|true|truth|[os])$'
    '|^(转台|台面|台体|速率台|[内中外]框|基准|参考|标准|指令|设定|给定|输入|目标|期望|温箱|地球|地速|电机)|转速'
    '|^(轉台|速率台|基準|標準|設定|給定|目標|テーブル|モータ)|轉速|回転数');

create or replace macro is_output_name(signal) as
  (regexp_matches(signal, '^rate(_|$)|^gyro(_[xyz])?$') or is_integrated_output(signal)
    -- _CHINESE of ingest/importing/tested_units.py
    or regexp_matches(lower(signal), '^(([xyz][轴向]?|航向|俯仰|横滚|滚转)_?)?((光纤|激光)?陀螺仪?|角速[率度])'
      '(输出(信号|脉冲|计数|电压)?|信号|脉冲|计数)?数?值?_?([xyz][轴向]?|[0-9]+)?$')) and not is_instrument_name(signal);

create or replace macro no_scale_factor(unit_of_measure) as
  'no scale factor for an output in ' || unit_of_measure || ': measure it or give the nominal one of the product';

-- The output that a signal is a form of: rate, rate_filtered and rate_compensated are one; gyro_1 and gyro_2, gyro_east
-- and gyro_north are two.
create or replace macro internal.output_of(signal) as
  regexp_replace(lower(signal), '(_?(raw|filt|filtered|lpf|comp|compensated|corr|corrected|calibrated|smoothed?|mean'
    '|averaged?|[0-9]+m?s|(原始|滤波|补偿|修正|校正|标定|平滑|平均)[值前后]?))+$', '');

create or replace view internal.gyro_steps as
select s.*, r.deg_per_h as rate_factor,
  body_axis_of(s.signal, min(internal.output_of(s.signal)) over outputs = max(internal.output_of(s.signal)) over outputs)
    as body_axis,
  case when r.deg_per_h is null then s.unit_of_measure else 'deg/s' end as output_unit
from step_means s left join internal.rate_units r using (unit_of_measure)
where is_output_name(s.signal) or (r.deg_per_h is not null and not is_instrument_name(s.signal))
window outputs as (partition by s.run, s.unit);
