-- What Earth's rate adds to a static mean, by where the input reference axis (IRA) points and the station's latitude.
-- Null where the position word does not say so or the latitude is unknown: then no corrected value is reported.
create or replace macro earth_rate_deg_per_h() as 15.041067;

create or replace macro earth_projection(position, latitude_deg) as
  case
    when regexp_matches(position, '^IRA_(east|west|east_west)$') then 0.0
    when position in ('IRA_up', 'vertical_up') then sin(radians(latitude_deg))
    when position in ('IRA_down', 'vertical_down') then -sin(radians(latitude_deg))
    when position = 'IRA_north' then cos(radians(latitude_deg))
    when position = 'IRA_south' then -cos(radians(latitude_deg))
  end * earth_rate_deg_per_h();
