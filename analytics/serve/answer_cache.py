"""Answers kept for the next who asks the same of the same version of the store; each is computed once."""

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

_MOST_BYTES = 64 << 20
_LARGEST_SHARE = 8


@dataclass(frozen=True)
class Answer:
    """The body of an answer, and its media type; headers say what a table cannot, as that there is more of it.

    `status` is that of HTTP where it is not the operation's own.
    """

    body: bytes
    media_type: str
    headers: tuple[tuple[str, str], ...] = ()
    status: int = 0


class AnswerCache:
    """Answers by key, the latest used of them up to 64 MiB; used from one event loop."""

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[tuple[str, ...], tuple[Answer, float]] = OrderedDict()  # and when it was begun
        self._making: dict[tuple[str, ...], asyncio.Task[Answer]] = {}
        self.bytes = self.hits = self.misses = 0

    async def answer(
        self, key: tuple[str, ...], make: Callable[[], Awaitable[Answer]], most_s: float = math.inf,
        *, stale_s: float = 0.0,
    ) -> Answer:  # fmt: skip
        """The answer kept, for `most_s` at most, else the one that `make` gives; who asks meanwhile waits for it.

        For `stale_s` after that the kept answer is given while the next one is made.
        """
        kept = self._kept.get(key)
        age_s = math.inf if kept is None else time.monotonic() - kept[1]
        if kept is not None and age_s <= most_s + stale_s:
            self._kept.move_to_end(key)
            self.hits += 1
            if age_s > most_s and key not in self._making:
                self._begin(key, make).add_done_callback(_seen)
            return kept[0]
        task = self._making.get(key)
        if task is None:
            task = self._begin(key, make)
        return await asyncio.shield(task)

    def _begin(self, key: tuple[str, ...], make: Callable[[], Awaitable[Answer]]) -> "asyncio.Task[Answer]":
        self.misses += 1
        task = self._making[key] = asyncio.ensure_future(self._made(key, make))
        return task

    async def _made(self, key: tuple[str, ...], make: Callable[[], Awaitable[Answer]]) -> Answer:
        began_s = time.monotonic()
        try:
            answer = await make()
        finally:
            del self._making[key]
        if len(answer.body) <= self._most_bytes // _LARGEST_SHARE:
            if (before := self._kept.pop(key, None)) is not None:
                self.bytes -= len(before[0].body)
            self._kept[key] = answer, began_s
            self.bytes += len(answer.body)
            while self.bytes > self._most_bytes:
                _, (oldest, _) = self._kept.popitem(last=False)
                self.bytes -= len(oldest.body)
        return answer


def _seen(task: "asyncio.Task[Answer]") -> None:
    """Take note of an error that nobody waits for: who asks next gets it."""
    if not task.cancelled():
        task.exception()
