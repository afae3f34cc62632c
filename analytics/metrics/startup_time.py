"""Start-up time: from power-on until the output stays within the product's error band."""

from functools import partial

from analytics.methods.settling_time import settling_times

HEADER = """\
-- id:        startup_time
-- en:        Start-up time
-- zh:        启动时间
-- unit:      s
-- better:    lower
-- grain:     unit, signal, run, test
-- parameters: test, tests, band_deg_per_h, reference, counted_from
-- source:    GJB 2426A-2004 5.5; JJF 2014-2022 7.2.23
-- needs:     procedure startup_time: power-on at several rates and positions; startup_band_deg_per_h of the product
-- limits:    given
-- equation:  max(t_r1, ..., t_rm, t_p1, ..., t_pn)
"""

compute = partial(settling_times, procedure="^startup_time|^start_up|启动时间")
