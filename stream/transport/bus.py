"""The interface of a bus, and a bus within one process."""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Protocol, runtime_checkable

from stream.closing import Closing

Handler = Callable[[str, bytes], None]


class Bus(Protocol):
    """Publish and subscribe by key expression. A handler gets (key, payload); if it raises, others are still called."""

    def publish(self, key: str, payload: bytes) -> None:
        """Send `payload` under `key`; waits where the bus is congested."""

    def subscribe(self, key_expression: str, handler: Handler) -> None:
        """Call `handler` for every message that matches, in the order of each source."""

    def unsubscribe(self, key_expression: str) -> None:
        """Call no handler of that key expression any more."""

    def close(self) -> None:
        """Leave the bus."""


@runtime_checkable
class Admitted(Protocol):
    """A bus whose other side admits certificates."""

    def why_refused(self) -> str:
        """Why the other side refuses this one, as the end of a sentence; empty if it does not, or does not answer."""


class LocalBus(Closing):
    """A bus within one process: a message is handled before `publish` returns.

    Key expressions are matched in two forms: exact, and ``prefix/**``, which matches no key that has a chunk
    beginning with ``@`` below the prefix.

    >>> bus, seen = LocalBus(), []
    >>> bus.subscribe("gyrofleet/**", lambda key, payload: seen.append(key))
    >>> bus.publish("gyrofleet/plant/chamber-2/event", b"")
    >>> bus.publish("gyrofleet/@acknowledgement", b"")
    >>> seen
    ['gyrofleet/plant/chamber-2/event']
    """

    def __init__(self) -> None:
        self._handlers: dict[str, list[Handler]] = defaultdict(list)
        self._lock = threading.RLock()

    def publish(self, key: str, payload: bytes) -> None:
        """Hand `payload` to every handler that matches."""
        with self._lock:
            found = [handlers for expression, handlers in self._handlers.items() if _matches(expression, key)]
            matching = [handler for handlers in found for handler in handlers]
        call_handlers(matching, key, payload)

    def subscribe(self, key_expression: str, handler: Handler) -> None:
        """Call `handler` for every message that matches."""
        with self._lock:
            self._handlers[key_expression].append(handler)

    def unsubscribe(self, key_expression: str) -> None:
        """Call no handler of that key expression any more."""
        with self._lock:
            self._handlers.pop(key_expression, None)

    def close(self) -> None:
        """Forget all handlers."""
        with self._lock:
            self._handlers.clear()


def call_handlers(handlers: Iterable[Handler], key: str, payload: bytes) -> None:
    """Call all handlers with a message; an error is reported by `threading.excepthook`, and the next one is called.

    >>> seen, raised, hook = [], [], threading.excepthook
    >>> threading.excepthook = lambda failure: raised.append(failure.exc_type)
    >>> call_handlers([lambda key, payload: 1 / 0, lambda key, payload: seen.append(key)], "gyrofleet/x", b"")
    >>> threading.excepthook = hook
    >>> seen, raised
    (['gyrofleet/x'], [<class 'ZeroDivisionError'>])
    """
    for handler in handlers:
        try:
            handler(key, payload)
        except Exception as error:  # noqa: BLE001  a mistake of this handler alone
            failure = (type(error), error, error.__traceback__, threading.current_thread())
            threading.excepthook(threading.ExceptHookArgs(failure))


def queued_bytes(key: str, payload: bytes) -> int:
    """Memory of a message in a queue: its payload, at most 4 bytes a character of its key, and the objects."""
    return len(payload) + 4 * len(key) + 300


def _matches(expression: str, key: str) -> bool:
    if not expression.endswith("/**"):
        return expression == key
    prefix = expression.removesuffix("**")
    return key.startswith(prefix) and not any(chunk.startswith("@") for chunk in key[len(prefix) :].split("/"))
