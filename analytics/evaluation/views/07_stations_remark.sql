-- The remark on what was measured at several stations: what differs between these is in the scatter. Null at one.
create or replace macro stations_remark(stations) as
  case when len(list_distinct(stations)) > 1 then
    'measured at ' || len(list_distinct(stations)) || ' stations (' || array_to_string(list_sort(list_distinct(stations)), ', ')
      || '): what differs between these is in the scatter' end;
