"""Addresses at which nobody listens."""

import random
import socket

# below those that the system gives to outgoing connections, which could take one between the look and the use
_FIRST, _LAST = 15_000, 32_000
_RANDOM = random.SystemRandom()


def free_endpoint() -> str:
    """An address on loopback at which nobody listens.

    Examples
    --------
    >>> free_endpoint().startswith("tcp/127.0.0.1:")
    True
    """
    while True:
        port = _RANDOM.randrange(_FIRST, _LAST)
        with socket.socket() as free:
            try:
                free.bind(("127.0.0.1", port))
            except OSError:
                continue
        return f"tcp/127.0.0.1:{port}"
