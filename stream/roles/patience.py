"""Requests to servers that end with the process: one without an answer is given up soon after a signal.

The client of an object store waits and retries for minutes, and a signal does not reach it. So each request has a
thread of its own, and whoever waits for it looks up. What was given up may have had its effect, as after an answer
that was lost.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from stream.terminal.console import seconds_since_stop

T = TypeVar("T")
_GRACE_S = 5.0  # of all requests together, from the signal on
_LOOK_S = 0.1


class GivenUp(Exception):
    """The process is to end, and the answer has not come."""


def answered(request: Callable[[], T]) -> T:
    """What a request returns or raises; GivenUp if the process was asked to end some seconds ago."""
    answer: Future[T] = Future()

    def ask() -> None:
        try:
            answer.set_result(request())
        except BaseException as error:  # noqa: BLE001  raised again below; a panic of the client is no Exception
            answer.set_exception(error)

    if _is_over():
        raise GivenUp
    threading.Thread(target=ask, name="gyrofleet-request", daemon=True).start()
    while wait([answer], _LOOK_S).not_done:
        if _is_over():
            raise GivenUp
    return answer.result()


def _is_over() -> bool:
    since_s = seconds_since_stop()
    return since_s is not None and since_s > _GRACE_S
