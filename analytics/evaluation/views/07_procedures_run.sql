-- Whether a procedure was run at all, of any unit: without it the metrics that are of its steps alone are not computed.
create or replace view internal.power_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^power|功耗');

create or replace view internal.startup_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^startup_time|^start_up|启动时间');

create or replace view internal.warmup_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^warm_?up_time|预热时间');

create or replace view internal.threshold_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^threshold|阈值');

create or replace view internal.resolution_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^resolution|分辨率');

create or replace view internal.polarity_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^polarity|极性');

create or replace view internal.random_walk_procedures as
from internal.procedures_of_steps where regexp_matches("procedure", '^random_walk|随机游走');
