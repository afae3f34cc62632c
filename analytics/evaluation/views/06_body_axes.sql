-- Axes of a device by the names of its signals and by the words of positions: X, Y, Z, or HEADING, PITCH, ROLL where the
-- names are those of rotations. Rotations are not turned into letters: JJF 1536-2015 5.3 to 5.5 put heading, pitch and
-- roll on X, Y, Z, its annex B on Z, X, Y.

-- The axis that a signal names: rate_x, angularratey, gyro_z, xrate, wx, angle_x, roll_rate; null where it names none.
create or replace macro named_axis_of(signal) as
  case
    when regexp_matches(lower(signal), '(^|_)(heading|yaw|azimuth)(_|rate|$)') then 'HEADING'
    when regexp_matches(lower(signal), '(^|_)pitch(_|rate|$)') then 'PITCH'
    when regexp_matches(lower(signal), '(^|_)roll(_|rate|$)') then 'ROLL'
    else nullif(upper(coalesce(
      nullif(regexp_extract(lower(signal), '(^|_)([xyz])(_|$)', 2), ''),
      nullif(regexp_extract(lower(signal), '(rate|gyro|gyr|omega|velocity|vel|spin|turn|angle|^w|_w)([xyz])(_|$)', 2), ''),
      nullif(regexp_extract(lower(signal), '(^|_)([xyz])(rate|gyro|gyr|omega|velocity|vel|spin|turn|angle)', 2), '')
    )), '')
  end;

-- An output that is the angle turned so far, or its pulses: records of steps are of its rate (`is_integrated` in
-- analytics/step_records/integrated_output.py).
create or replace macro is_integrated_output(signal) as
  regexp_matches(lower(signal), '^angle_([xyz]|heading|yaw|azimuth|pitch|roll)$');

-- The IRA of a signal rate_x is X; that of a gyro with one axis is Z (JJF 2014-2022 figure 2: IRA is o'z').
create or replace macro body_axis_of(signal) as
  coalesce(named_axis_of(signal), case when not regexp_matches(lower(signal), '[xyz]$') then 'Z' end);

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
