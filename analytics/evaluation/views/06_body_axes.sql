-- Axes of a device by the names of its signals and by the words of positions: X, Y, Z, or HEADING, PITCH, ROLL where the
-- names are those of rotations. Rotations are not turned into letters: JJF 1536-2015 5.3 to 5.5 put heading, pitch and
-- roll on X, Y, Z, its annex B on Z, X, Y.

-- The axis that a signal names: rate_x, angularratey, gyro_z, xrate, wx, angle_x, roll_rate, X轴角速率, 陀螺X, 俯仰角速率; null
-- where it names none. `signal_axis` of stream/channel_names.py knows the same letters.
create or replace macro named_axis_of(signal) as
  case
    when regexp_matches(lower(signal), '(^|_)(heading|yaw|azimuth)(_|rate|$)|航向|方位') then 'HEADING'
    when regexp_matches(lower(signal), '(^|_)pitch(_|rate|$)|俯仰') then 'PITCH'
    when regexp_matches(lower(signal), '(^|_)roll(_|rate|$)|横滚|滚转') then 'ROLL'
    else nullif(upper(coalesce(
      nullif(regexp_extract(lower(signal), '(^|[^a-z0-9])([xyz])([^a-z0-9]|$)', 2), ''),
      nullif(regexp_extract(lower(signal), '(rate|gyro|gyr|omega|velocity|vel|spin|turn|angle|^w|_w)([xyz])([^a-z0-9]|$)', 2), ''),
      nullif(regexp_extract(lower(signal), '(^|[^a-z0-9])([xyz])(rate|gyro|gyr|omega|velocity|vel|spin|turn|angle)', 2), '')
    )), '')
  end;

-- An output that is the angle turned so far, or its pulses: records of steps are of its rate (`is_integrated` in
-- analytics/step_records/integrated_output.py).
create or replace macro is_integrated_output(signal) as
  regexp_matches(lower(signal), '^angle_([xyz]|heading|yaw|azimuth|pitch|roll)$');

-- The IRA of a signal rate_x is X; that of a gyro with one axis is Z (JJF 2014-2022 figure 2: IRA is o'z'). Of several
-- outputs whose names say no axis nobody knows which is which: null.
create or replace macro body_axis_of(signal, is_only_output) as
  coalesce(named_axis_of(signal),
    case when is_only_output and not regexp_matches(lower(signal), '[xyz][0-9]*([^a-z0-9]|$)') then 'Z' end);

create or replace macro no_body_axis() as
  'its axis is not known, so the Earth''s rate cannot be removed: name it gyro_x, or X轴陀螺';

-- The axis that the word `axis` of a step names.
create or replace macro axis_word_of(axis) as
  replace(nullif(upper(regexp_extract(lower(trim(axis)),
    '^[+-]?(axis[ _-]?|rate_|gyro_)?([xyz]|heading|yaw|pitch|roll)([ _-]?axis|轴|_up|_down)?[+-]?$', 2)), ''), 'YAW', 'HEADING');

-- The axis of which a position says whether it is up or down.
create or replace macro axis_in(position) as
  replace(nullif(upper(regexp_extract(position,
    '^[+-]?([XYZ]|[Hh]eading|[Yy]aw|[Pp]itch|[Rr]oll)(_|[+-]|$)', 1)), ''), 'YAW', 'HEADING');

create or replace macro side_in(position) as
  case
    when regexp_matches(position, '_up$|[+]$|^[+]') then 1
    when regexp_matches(position, '_down$|-$|^-') then -1
  end;
