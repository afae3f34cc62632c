"""One file an instrument."""

from stream.files.own_files import add_own

add_own(__path__, "instruments")
