"""Change of the bias by vibration, along each axis and the largest."""

from functools import partial

from analytics.methods.largest_magnitude import bias_changes

HEADER = """\
-- id:        bias_vibration_change
-- en:        Bias change by vibration
-- zh:        零偏振动前后变化量
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, axis
-- parameters: axis, repeat, scale_factor, axis_of_largest
-- source:    JJF 2014-2022 7.2.19 (33)
-- needs:     procedure bias_vibration: static steps before and after a vibration along X, Y and Z
-- limits:    given
-- equation:  abs(B_after - B_before) along each axis; of the unit the largest
"""

compute = partial(bias_changes, cause="vibration")
