"""The clock of a station: that of the computer, or, where everything is simulated, one that runs faster."""

import time

from stream.errors import BadInput


class StationClock:
    """Time of day at a station, in nanoseconds UTC.

    Whoever drives or reads instruments asks this clock and waits by it, so that a simulated station can run through a
    day in minutes. At a speed of 1 it is the computer's clock. It shows `start_ns`, by default the time of day, at the
    moment `origin_s` of `time.time()`, by default now; clocks of several processes agree if they share it. Raises
    BadInput if the speed is not positive.

    >>> clock = StationClock(speed=1000.0, start_ns=0)
    >>> clock.sleep(0.5)
    >>> 0.5 <= clock.now_ns() / 1e9
    True
    """

    def __init__(self, speed: float = 1.0, start_ns: int | None = None, origin_s: float | None = None) -> None:
        if not 0.0 < speed <= 1e6:
            raise BadInput(f"a station clock of speed {speed}: more than 0 and at most 1e6 times real time")
        self.speed = speed
        self._monotonic_s = time.monotonic() - time.time()  # of the epoch, so that a step of the clock does not matter
        self.origin_s = time.time() if origin_s is None else origin_s
        self.start_ns = round(self.origin_s * 1e9) if start_ns is None else start_ns

    def now_ns(self) -> int:
        """Time at the station now."""
        return self.at_ns(time.monotonic() - self._monotonic_s)

    def at_ns(self, computer_s: float) -> int:
        """Time at the station at a moment of the computer's clock, seconds since 1970."""
        return self.start_ns + round((computer_s - self.origin_s) * self.speed * 1e9)

    def computer_s(self, station_s: float) -> float:
        """How long so many seconds at the station take on the computer."""
        return station_s / self.speed

    def sleep(self, station_s: float) -> None:
        """Wait so many seconds at the station."""
        if station_s > 0.0:
            time.sleep(self.computer_s(station_s))
