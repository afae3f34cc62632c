"""The order in which parallel processes run the tests: what takes long or waits for a clock begins first.

pytest-xdist (`--dist loadfile --no-loadscope-reorder`) gives whole modules in their order to the processes that have
time. Rooms of long tests take turns, so that not all processes wait for stations at once; at the end there are short
tests, and nobody waits.
"""

from collections.abc import Sequence
from itertools import chain, groupby, zip_longest

# the first room that a module is in counts
_LONG_ROOMS = ("tests/e2e/station/", "tests/e2e/", "tests/analytics/serve/", "tests/crash/")
# in these most tests take over half a second
_MIDDLE_ROOMS = ("tests/test_", "tests/analytics/", "tests/storage/")


def longest_first(names: Sequence[str]) -> list[int]:
    """Places of the tests, by their node ids, in the order in which to run them.

    >>> names = ["a.py::1", "tests/crash/b.py::1", "tests/crash/c.py::1", "tests/e2e/d.py::1", "tests/e2e/d.py::2"]
    >>> [names[place] for place in longest_first(names)]
    ['tests/e2e/d.py::1', 'tests/e2e/d.py::2', 'tests/crash/b.py::1', 'tests/crash/c.py::1', 'a.py::1']
    """
    modules = [list(places) for _, places in groupby(range(len(names)), lambda place: names[place].split("::")[0])]
    ranked = [(_rank(names[module[0]]), module) for module in modules]
    rooms = [[module for rank, module in ranked if rank == room] for room in _LONG_ROOMS]
    turns = chain.from_iterable(zip_longest(*rooms, fillvalue=()))
    middle = (module for rank, module in ranked if rank in _MIDDLE_ROOMS)
    short = (module for rank, module in ranked if not rank)
    return list(chain.from_iterable((*turns, *middle, *short)))


def _rank(name: str) -> str:
    """The room whose place in the order a test takes; none for the others, which are short."""
    return next((room for room in (*_LONG_ROOMS, *_MIDDLE_ROOMS) if name.startswith(room)), "")
