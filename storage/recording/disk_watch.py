"""Disk space: an early warning, and a pause of recording before the disk is full."""

from pathlib import Path

from storage.segments.disk import Disk

_RESERVE_BYTES = 256 << 20
_RESERVE_SHARE = 0.05
_EARLY_RESERVES = 10
_LOOK_EVERY_S = 1.0
_MARK_EVERY_S = 10.0
# over how long the disk has filled, and for how many hours there is room at that rate: one large file fills no disk
_SOON = ((60.0, 0.5), (600.0, 4.0), (3600.0, 24.0))
_OVER = 2.0  # so many times that long, and the warning is over


class DiskWatch:
    """Watches the free space of a store's disk; `reserve_bytes`, 256 MB or a twentieth, are kept free to finish."""

    def __init__(self, folder: Path, disk: Disk) -> None:
        self._folder, self._disk = folder, disk
        space = disk.space(folder)
        self.reserve_bytes = min(_RESERVE_BYTES, int(_RESERVE_SHARE * space.total))
        self.free_bytes = space.free  # at the last look
        self._looked_at = 0.0
        self._marks: list[tuple[float, int]] = []
        self._has_warned = False

    def look(self, now: float, *, again: bool = False) -> tuple[str | None, str | None]:
        """Why nothing more may be written, and a warning, given once; looks once a second at most unless `again`."""
        if not again and now - self._looked_at < _LOOK_EVERY_S:
            return None, None
        self._looked_at = now
        space = self._disk.space(self._folder)
        self.free_bytes = space.free
        room = f"{format_bytes(space.free)} free of {format_bytes(space.total)} on the disk of {self._folder}"
        if space.free < self.reserve_bytes:
            reserve = format_bytes(self.reserve_bytes)
            return f"{room}, {reserve} are kept in reserve: free space, recording then resumes", None
        return None, self._warning(now, space.free, room)

    def _warning(self, now: float, free: int, room: str) -> str | None:
        if not self._marks or now - self._marks[-1][0] >= _MARK_EVERY_S:
            longest_s = _SOON[-1][0] + _MARK_EVERY_S
            self._marks = [(at, was) for at, was in self._marks if now - at <= longest_s] + [(now, free)]
        had_warned, times = self._has_warned, _OVER if self._has_warned else 1.0
        soon = [
            (hours, over_s) for over_s, within_h in _SOON
            if (hours := self._hours_left(now, free, over_s)) is not None and hours < times * within_h
        ]  # fmt: skip
        self._has_warned = free < times * _EARLY_RESERVES * self.reserve_bytes or bool(soon)
        if had_warned or not self._has_warned:
            return None
        forecast = ""
        if soon:
            hours, over_s = min(soon)
            forecast = f", enough for {hours:.3g} h at the rate of the last {over_s / 60:.0f} min"
        return f"the disk is running full: {room}{forecast}"

    def _hours_left(self, now: float, free: int, over_s: float) -> float | None:
        """Until the reserve is reached at the rate of the last `over_s`; None if unknown, or if nothing is written."""
        before = [mark for mark in self._marks if now - mark[0] >= over_s]
        if not before:
            return None
        since, was = before[-1]
        rate = (was - free) / (now - since)
        return (free - self.reserve_bytes) / rate / 3600 if rate > 0.0 else None

    def has_room_again(self) -> bool:
        """Whether twice the reserve is free, for hysteresis."""
        return self._disk.space(self._folder).free >= 2 * self.reserve_bytes


def format_bytes(size: int) -> str:
    """A size with its unit.

    >>> format_bytes(8_123_456), format_bytes(512), format_bytes(3_000_000_000)
    ('8.1 MB', '512 B', '3.0 GB')
    """
    for factor, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= factor:
            return f"{size / factor:.1f} {name}"
    return f"{size} B"
