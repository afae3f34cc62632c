"""Conditions that a rule can have, one a file."""

from stream.files.own_files import add_own

add_own(__path__, "conditions")
