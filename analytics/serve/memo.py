"""Results that pages and the API share, each computed once for a version of the lake."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

_MOST = 64


class Memo:
    """The latest used results by key; who asks for one that is being computed waits for it. For several threads."""

    def __init__(self, most: int = _MOST) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._making: dict[Hashable, threading.Lock] = {}
        self._newest: dict[str, Hashable] = {}
        self._lock = threading.Lock()

    def result(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The kept result, else the one that `make` gives; an error is not kept.

        >>> memo = Memo()
        >>> memo.result("a", lambda: 1), memo.result("a", lambda: 2)
        (1, 1)
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            making = self._making.setdefault(key, threading.Lock())
        with making:
            with self._lock:
                if key in self._kept:
                    return self._kept[key]
            try:
                found = make()
            finally:
                with self._lock:
                    self._making.pop(key, None)
            with self._lock:
                self._kept[key] = found
                while len(self._kept) > self._most:
                    self._kept.popitem(last=False)
            return found

    def newest(self, name: str, version: Hashable, make: Callable[[], Any]) -> Any:
        """The same of something large: only that of the version that was asked for last is kept.

        >>> memo = Memo()
        >>> memo.newest("a", 1, lambda: "x"), memo.newest("a", 2, lambda: "y"), memo.newest("a", 1, lambda: "z")
        ('x', 'y', 'z')
        """
        found = self.result((name, version), make)
        with self._lock:
            before, self._newest[name] = self._newest.get(name, version), version
            if before != version:
                self._kept.pop((name, before), None)
        return found
