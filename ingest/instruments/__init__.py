"""One file an instrument."""

from stream.own_files import add_own

add_own(__path__, "instruments")
