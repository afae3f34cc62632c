"""When a recorder warns that its disk fills."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from storage.recording.disk_watch import DiskWatch
from storage.segments.disk import Disk, Space

SIZE, GB, HOUR = 1_000 * 10**9, 10**9, 3600


class Filling(Disk):
    """A disk of 1 TB with so much free at each second."""

    def __init__(self, free: Callable[[float], float]) -> None:
        self._free, self.now = free, 0.0

    def space(self, folder: Path) -> Space:
        return Space(total=SIZE, free=round(self._free(self.now)))


def warnings(free: Callable[[float], float], hours: float, tmp_path: Path) -> list[tuple[float, str]]:
    disk = Filling(free)
    watch = DiskWatch(tmp_path, disk)
    found = []
    for second in range(1, round(hours * HOUR)):
        disk.now = float(second)
        _, warning = watch.look(disk.now)
        if warning is not None:
            found.append((second / HOUR, warning))
    return found


def test_one_large_file_fills_no_disk(tmp_path: Path) -> None:
    """300 MB of another program were "enough for 1.26 h", eight times in four minutes."""
    assert warnings(lambda t: (25.0 - 0.3 * (t > 1000)) * GB, 2.0, tmp_path) == []
    assert warnings(lambda t: (25.0 - 0.1 * (t // 900)) * GB, 2.0, tmp_path) == []


@pytest.mark.parametrize(
    ("left_h", "by_h", "named"), [(0.4, 0.02, "last 1 min"), (3.0, 0.2, "last 10 min"), (20.0, 1.1, "last 60 min")]
)
def test_a_disk_that_fills_is_named_once_and_early(left_h: float, by_h: float, named: str, tmp_path: Path) -> None:
    start = 500 * GB
    found = warnings(lambda t: start * (1.0 - t / (left_h * HOUR)), min(0.9 * left_h, 3.0), tmp_path)
    ((at_h, text),) = found
    assert at_h < by_h
    assert named in text


def test_a_rate_about_the_limit_is_named_once(tmp_path: Path) -> None:
    """The bound of what is over lies apart from that of what begins."""
    start = 700 * GB

    def free(t: float) -> float:
        wave = 1800.0 * math.sin(t / 1800.0)  # the pace is from 0.7 to 1.3
        return start - start * (t + 0.3 * wave) / (27.0 * HOUR)

    assert len(warnings(free, 6.0, tmp_path)) == 1
