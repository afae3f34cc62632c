"""A thread that reports the status of a role every second."""

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress

import msgspec

from stream.closing import Closing
from stream.errors import GyrofleetError
from stream.status.role_status import RoleState, RoleStatus

REPORT_EVERY_S = 1.0

Collect = Callable[[], RoleStatus]


class StatusReporter(Closing):
    """Hands the status that `collect` gives to `put`, every second and once more, as ended, when it is closed.

    A status that cannot be collected or put is left out: reporting ends no role.
    """

    def __init__(self, collect: Collect, put: Callable[[RoleStatus], None], every_s: float = REPORT_EVERY_S) -> None:
        self._collect, self._put, self._every_s = collect, put, every_s
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Report the end of the role."""
        if not self._closing.is_set():
            self.kill()
            self._report(RoleState.ENDED)

    def kill(self) -> None:
        """Report nothing more, like a process that is killed."""
        self._closing.set()
        self._thread.join()

    def _loop(self) -> None:
        while True:
            self._report(None)
            if self._closing.wait(self._every_s):
                return

    def _report(self, state: RoleState | None) -> None:
        with suppress(GyrofleetError, OSError):
            status = self._collect()
            is_kept = status.state in {RoleState.FAILED, RoleState.INTERRUPTED}
            self._put(status if state is None or is_kept else msgspec.structs.replace(status, state=state))


def served(address: str | None, collect: Collect) -> AbstractContextManager[object]:
    """Serve `/metrics` and `/health` at an address, nothing without one; BadInput if it cannot be listened on."""
    if address is None:
        return nullcontext()
    from stream.status.endpoint import StatusEndpoint

    return StatusEndpoint(address, collect)
