"""Effects that a gyro's error model may lack, one file for each family."""

from stream.files.own_files import add_own

add_own(__path__, "effects")
