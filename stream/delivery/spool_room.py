"""How full a spool is: room for documents beside samples, and warnings for people."""

import datetime as dt
import time
from pathlib import Path

_LEVELS = (0.9, 0.75, 0.5)
_FELL = 0.1  # below a level, before it is over
_SPARE, _MOST_SPARE_BYTES = 1 / 16, 1 << 20
_TREND_S = 1.0
_MINUTE_S = 60.0


class SpoolRoom:
    """The room of a spool of `max_bytes`; its last part is for documents alone, so that they do not wait for samples.

    `full_since` is when samples began to wait; None while there is room.

    >>> room = SpoolRoom(Path("spool"), 1600)
    >>> room.fits(1500, is_document=False), room.fits(1501, is_document=False), room.fits(1501, is_document=True)
    (True, False, True)
    >>> room.grew(100, now_s=0.0)
    >>> room.grew(800, now_s=70.0)
    >>> str(room.warning)[:81]
    'the spool spool is 50 % full, with room for 1 min at the present rate: start `gyr'
    """

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder, self._max_bytes = folder, max_bytes
        self._most_bytes = max_bytes - min(round(_SPARE * max_bytes), _MOST_SPARE_BYTES)
        self._trend: tuple[float, int] | None = None
        self._level = 0.0
        self._filling: str | None = None
        self.full_since: dt.datetime | None = None

    @property
    def warning(self) -> str | None:
        """That it is full, or will be; None where neither is so."""
        if self.full_since is None:
            return self._filling
        return (
            f"the spool {self._folder} is full: lines and buses are not read since {self.full_since:%H:%M:%S} UTC, and "
            "what they send is lost; start `gyrofleet record` again, or let the spool be larger (--spool-mb)"
        )

    def fits(self, size: int, *, is_document: bool) -> bool:
        """Whether all files may have so many bytes together; where not, samples wait from now on."""
        is_room = size <= (self._max_bytes if is_document else self._most_bytes)
        if not is_room and not is_document and self.full_since is None:
            self.full_since = dt.datetime.now(dt.UTC)
        return is_room

    def acknowledged(self) -> None:
        """A recorder takes what waits: the trend begins again."""
        self._trend = None

    def grew(self, size: int, now_s: float | None = None) -> None:
        """All files have so many bytes together."""
        now_s = time.monotonic() if now_s is None else now_s
        share = size / self._most_bytes
        if share < _LEVELS[0]:
            self.full_since = None
        if self._trend is None:
            self._trend = now_s, size
        level = next((each for each in _LEVELS if share >= each), 0.0)
        if level > self._level and now_s - self._trend[0] >= _TREND_S:
            self._level, self._filling = level, self._forecast(level, size, now_s)
        elif share < self._level - _FELL:
            self._level, self._filling = 0.0, None

    def _forecast(self, level: float, size: int, now_s: float) -> str:
        began_s, before = self._trend or (now_s, size)
        rate = (size - before) / max(now_s - began_s, 1e-9)
        left_s = (self._most_bytes - size) / rate if rate > 0.0 else 0.0
        left = f"{left_s / _MINUTE_S:,.0f} min" if left_s >= _MINUTE_S else f"{left_s:.0f} s"
        room = f", with room for {left} at the present rate" if rate > 0.0 else ""
        return (
            f"the spool {self._folder} is {100 * level:.0f} % full{room}: start `gyrofleet record` again; once it is "
            "full, lines and buses are not read any more"
        )
