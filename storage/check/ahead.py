"""Values made beside the work on those before them: decompressing and checksums leave the interpreter to others."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_AHEAD = 2


def ahead(values: Iterator[T]) -> Iterator[T]:
    """The values of an iterator, of which another thread makes the next two meanwhile; its errors come in their turn.

    >>> list(ahead(iter("abc")))
    ['a', 'b', 'c']
    """
    with ThreadPoolExecutor(1) as beside:
        waiting: deque[Future[tuple[T] | None]] = deque(beside.submit(_next, values) for _ in range(_AHEAD))
        while (found := waiting.popleft().result()) is not None:
            waiting.append(beside.submit(_next, values))
            yield found[0]


def _next(values: Iterator[T]) -> tuple[T] | None:
    for value in values:
        return (value,)
    return None
