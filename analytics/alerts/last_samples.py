"""When the last sample of each unit arrived, by a monotonic clock: a leap of the computer's clock silences no unit."""

from collections.abc import Mapping

from analytics.floor import UnitNow


class LastSamples:
    """Times of the last samples of units, by run and unit, on the clock of who looks."""

    def __init__(self) -> None:
        self._arrivals: dict[tuple[str, str], int] = {}
        self.last_sample_ns: dict[tuple[str, str], int] = {}

    def look(self, units: Mapping[str, UnitNow], now_ns: int, wall_ns: int) -> None:
        """Note which units have sent since the last look; `wall_ns` is on the clock by which samples arrive.

        >>> samples = LastSamples()
        >>> samples.look({}, 10, 20)
        >>> samples.last_sample_ns
        {}
        """
        times: dict[tuple[str, str], int] = {}
        arrivals: dict[tuple[str, str], int] = {}
        for name, unit in units.items():
            key = (unit.run.run, name)
            before = self._arrivals.get(key)
            if before is None:  # perhaps of hours ago: only the clock of the arrivals knows
                times[key] = now_ns - max(0, wall_ns - unit.arrival_ns)
            else:
                times[key] = self.last_sample_ns[key] if unit.arrival_ns == before else now_ns
            arrivals[key] = unit.arrival_ns
        self._arrivals, self.last_sample_ns = arrivals, times
