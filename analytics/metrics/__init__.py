"""The characteristics of the test standards: one SQL file a metric, found by the registry."""

from stream.files.own_files import add_own

add_own(__path__, "metrics")
