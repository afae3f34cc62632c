"""Change of the bias by shocks, along each axis and the largest."""

from functools import partial

from analytics.methods.largest_magnitude import bias_changes

HEADER = """\
-- id:        bias_shock_change
-- en:        Bias change by shock
-- zh:        零偏冲击前后变化量
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, axis
-- parameters: axis, repeat, scale_factor, axis_of_largest
-- source:    JJF 2014-2022 7.2.18 (32)
-- needs:     procedure bias_shock: static steps before and after a shock along X, Y and Z
-- limits:    given
-- equation:  abs(B_after - B_before) along each axis; of the unit the largest
"""

compute = partial(bias_changes, cause="shock")
