-- What a small error of the station's references changes of the Earth's rate on the input reference axis (IRA), in
-- deg/h per arcsec: partial derivatives of `earth_projection`, each positive. Null where the position does not say how
-- the axis lies, or the latitude is unknown.
create or replace macro earth_pointing(position, body_axis) as
  case
    when regexp_matches(position, '^IRA_(east|west|east_west)$') then 'east'
    when regexp_matches(position, '^IRA_(north|south)$') then 'north'
    when earth_projection(position, 45, body_axis) is not null then 'vertical'
  end;

create or replace macro earth_rate_per_arcsec() as earth_rate_deg_per_h() * pi() / 648000;

-- A tilt of the IRA towards the pole, in the meridian; of one that points east, towards the vertical.
create or replace macro levelling_deg_per_h(position, latitude_deg, body_axis) as
  earth_rate_per_arcsec() * case earth_pointing(position, body_axis)
    when 'vertical' then abs(cos(radians(latitude_deg))) else abs(sin(radians(latitude_deg))) end
  * case when earth_pointing(position, body_axis) is not null then 1 end;

-- An error of north turns an IRA that points east into the Earth's horizontal rate; elsewhere it is of second order.
create or replace macro heading_deg_per_h(position, latitude_deg, body_axis) as
  case earth_pointing(position, body_axis)
    when 'east' then earth_rate_per_arcsec() * abs(cos(radians(latitude_deg)))
    when 'north' then 0.0
    when 'vertical' then 0.0
  end;

-- An error of the latitude enters what is removed.
create or replace macro latitude_deg_per_h(position, latitude_deg, body_axis) as
  case earth_pointing(position, body_axis)
    when 'east' then 0.0
    when 'north' then earth_rate_per_arcsec() * abs(sin(radians(latitude_deg)))
    when 'vertical' then earth_rate_per_arcsec() * abs(cos(radians(latitude_deg)))
  end;

-- What a relative error of 1 ppm changes of a value.
create or replace macro per_ppm(value) as abs(value) * 1e-6;

-- The same where the output is a voltage, and 0 where no voltmeter is read.
create or replace macro per_ppm_of_voltage(value, volt) as case when volt is null then 0.0 else abs(value) * 1e-6 end;
