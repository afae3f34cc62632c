"""The order in which parallel processes run the tests: what takes long or waits for a clock begins first.

pytest-xdist (`--dist worksteal`) gives each process an equal part of the tests in their order; who is done takes from
the end of another's part. A room of long tests is therefore begun by one process each, before the others' modules,
which are dealt so that all parts are equally long; at the end there are short tests, and nobody waits for a station.
"""

from collections.abc import Sequence
from itertools import chain, groupby

# the first room that a module is in counts
_LONG_ROOMS = ("tests/e2e/station/", "tests/e2e/", "tests/analytics/serve/", "tests/crash/")
# in these most tests take over half a second
_MIDDLE_ROOMS = ("tests/test_", "tests/analytics/", "tests/storage/")


def longest_first(names: Sequence[str], processes: int) -> list[int]:
    """Places of the tests, by their node ids, in the order in which to run them.

    Of two processes, the first begins with the room `e2e`, and the second with `crash`:

    >>> names = ["a.py::1", "a.py::2", "tests/crash/b.py::1", "tests/e2e/c.py::1", "tests/e2e/c.py::2"]
    >>> [names[place] for place in longest_first(names, 2)]
    ['tests/e2e/c.py::1', 'tests/e2e/c.py::2', 'tests/crash/b.py::1', 'a.py::1', 'a.py::2']
    """
    shares = [(len(names) + part) // processes for part in range(processes)]
    parts: list[list[int]] = [[] for _ in shares]
    modules = [list(places) for _, places in groupby(range(len(names)), lambda place: names[place].split("::")[0])]
    ranks = [_rank(names[module[0]]) for module in modules]
    for number, room in enumerate(room for room in _LONG_ROOMS if room in ranks):
        own = [module for module, rank in zip(modules, ranks, strict=True) if rank == room]
        parts[number % processes].extend(chain.from_iterable(own))
    for middle in (True, False):
        for module, rank in zip(modules, ranks, strict=True):
            if rank not in _LONG_ROOMS and (rank in _MIDDLE_ROOMS) == middle:
                min(zip(parts, shares, strict=True), key=lambda each: len(each[0]) - each[1])[0].extend(module)
    spare = [place for part, share in zip(parts, shares, strict=True) for place in part[share:]]
    for part, share in zip(parts, shares, strict=True):
        del part[share:]
        missing = share - len(part)
        part.extend(spare[:missing])
        del spare[:missing]
    return list(chain.from_iterable(parts))


def _rank(name: str) -> str:
    """The room whose place in the order a test takes; none for the others, which are short."""
    return next((room for room in (*_LONG_ROOMS, *_MIDDLE_ROOMS) if name.startswith(room)), "")
