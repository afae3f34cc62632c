"""Warm-up time of units with temperature control, measured like the start-up time."""

from functools import partial

from analytics.methods.settling_time import settling_times

HEADER = """\
-- id:        warmup_time
-- en:        Warm-up time
-- zh:        预热时间
-- unit:      s
-- better:    lower
-- grain:     unit, signal, run, test
-- parameters: test, tests, band_deg_per_h, reference, counted_from
-- source:    GJB 2426A-2004 5.6
-- needs:     procedure warmup_time: power-on at several rates and positions; startup_band_deg_per_h of the product
-- limits:    given
-- equation:  max(t_r1, ..., t_rm, t_p1, ..., t_pn)
"""

compute = partial(settling_times, procedure="^warm_?up_time|预热时间")
