-- What Earth's rate adds to a static mean, by where the input reference axis (IRA) points and the station's latitude.
-- Null where the position word does not say so or the latitude is unknown: then no corrected value is reported.
create or replace macro earth_rate_deg_per_h() as 15.041067;

create or replace macro no_latitude() as
  'no latitude of the station, so the Earth''s rate cannot be removed: give it in the station''s file, or import the '
  || 'file again with --latitude';

create or replace macro no_level_rate() as
  'no latitude, so the Earth''s rate on the axis is unknown: give the station''s latitude_deg';

-- A position may name the body axis that is up. Of the other axes the IRA is level, and no word tells its heading.
create or replace macro earth_projection(position, latitude_deg, body_axis) as
  case
    when regexp_matches(position, '^IRA_(east|west|east_west)$') then 0.0
    when regexp_matches(position, '^(IRA|vertical)_(up|down)$') or axis_in(position) = body_axis
      then side_in(position) * sin(radians(latitude_deg))
    when position = 'IRA_north' then cos(radians(latitude_deg))
    when position = 'IRA_south' then -cos(radians(latitude_deg))
  end * earth_rate_deg_per_h();
