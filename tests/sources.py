"""Where the packages under test are: the checkout, or where the wheel is installed."""

from pathlib import Path

import gyrofleet

SOURCES = Path(gyrofleet.__file__).parent
