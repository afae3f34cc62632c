"""When each unit was last heard of, by a clock that nobody sets: a leap of the computer's clock silences nobody."""

from collections.abc import Mapping

from analytics.floor import UnitNow


class Hearing:
    """Times of the last samples of units, by run and unit, on the clock of who looks."""

    def __init__(self) -> None:
        self._arrivals: dict[tuple[str, str], int] = {}
        self.heard_ns: dict[tuple[str, str], int] = {}

    def look(self, units: Mapping[str, UnitNow], now_ns: int, wall_ns: int) -> None:
        """Note who was heard since the last look; `wall_ns` is on the clock by which samples arrive.

        >>> hearing = Hearing()
        >>> hearing.look({}, 10, 20)
        >>> hearing.heard_ns
        {}
        """
        heard: dict[tuple[str, str], int] = {}
        arrivals: dict[tuple[str, str], int] = {}
        for name, unit in units.items():
            key = (unit.run.run, name)
            before = self._arrivals.get(key)
            if before is None:  # perhaps of hours ago: only the clock of the arrivals knows
                heard[key] = now_ns - max(0, wall_ns - unit.arrival_ns)
            else:
                heard[key] = self.heard_ns[key] if unit.arrival_ns == before else now_ns
            arrivals[key] = unit.arrival_ns
        self._arrivals, self.heard_ns = arrivals, heard
