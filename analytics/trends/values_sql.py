"""The statement for the values of a metric with when, where and in which lot each was measured.

Its parameters are `metric` and `unit`, which is empty for all units. A value is dated at the end of its last step.
"""

from importlib.resources import files

METRIC_VALUES = files("analytics.trends").joinpath("metric_values.sql").read_text()
