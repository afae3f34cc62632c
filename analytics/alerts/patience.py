"""How long a connection may take in all: a server that sends a byte now and then keeps nobody for ever."""

import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from stream.closing import Closing


class Patience(Closing):
    """Cuts a connection after `longest_s`, or when `cut` is called; `connection` gives its socket, if it has one yet.

    >>> one, other = socket.socketpair()
    >>> with other, one, Patience(0.01) as patience:
    ...     patience.connection = lambda: one
    ...     one.recv(1), patience.is_over
    (b'', True)
    """

    def __init__(self, longest_s: float) -> None:
        self.connection: Callable[[], socket.socket | None] = lambda: None
        self.is_over = False
        self._timer = threading.Timer(longest_s, self.cut)
        self._timer.daemon = True
        self._timer.start()

    def cut(self) -> None:
        """End the connection, at once."""
        self.is_over = True
        found = self.connection()
        if found is not None:
            with suppress(OSError):
                found.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Leave the connection alone from here on."""
        self._timer.cancel()
