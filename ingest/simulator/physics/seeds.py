"""Seeds by name: every random process of every unit and power-on has its own, whatever else is switched on."""

import numpy as np

_UNIT, _POWER_ON, _DAY = range(3)


class Seeds:
    """Seeds of one power-on of one unit.

    Parameters
    ----------
    seed: Of the fleet, not negative.
    unit: Serial number.
    power_on, day: Number of the power-on and of the day it falls on, not negative.

    Examples
    --------
    >>> seeds = Seeds(1, "FOG-1", power_on=2, day=1)
    >>> bool(seeds.of_power_on("white").random() == Seeds(1, "FOG-1", 2, 9).of_power_on("white").random())
    True
    >>> bool(seeds.of_power_on("white").random() == seeds.of_power_on("flicker").random())
    False
    """

    def __init__(self, seed: int, unit: str, power_on: int, day: int) -> None:
        self._seed, self._unit, self._power_on, self._day = seed, unit, power_on, day

    def of_power_on(self, process: str) -> np.random.Generator:
        """Generator of a process that is drawn anew at every power-on."""
        return self._generator(_POWER_ON, self._power_on, process)

    def of_day(self, process: str) -> np.random.Generator:
        """Generator of a process that all power-ons of a day share."""
        return self._generator(_DAY, self._day, process)

    def _generator(self, kind: int, number: int, process: str) -> np.random.Generator:
        return _named(self._seed, kind, number, self._unit, process)


def unit_generator(seed: int, unit: str, process: str) -> np.random.Generator:
    """Generator of what a unit keeps for life."""
    return _named(seed, _UNIT, 0, unit, process)


def _named(seed: int, kind: int, number: int, unit: str, process: str) -> np.random.Generator:
    # a name holds no zero byte, so that no two pairs of unit and process share a key
    key = (kind, number, *unit.encode(), 0, *process.encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
