"""Building the lake in the background of a recorder."""

import threading
from collections import deque
from collections.abc import Callable

from storage.lake.builder import LakeBusy, build_missing, builder_lock
from storage.store import Store
from stream.errors import StoreError
from stream.transport.scheduling import be_nicer

_RETRY_S = 10.0
_NICER = 5


class LakeBuilder:
    """A thread that builds the lake from sealed segments; a failure goes to `on_warning`, and is retried."""

    def __init__(self, store: Store, on_warning: Callable[[str], None]) -> None:
        self._store, self._on_warning = store, on_warning
        self._failure: StoreError | None = None
        self._is_wanted = True  # segments that an earlier process sealed
        self._closing = False
        self._caught_up = threading.Event()
        self._state = threading.Condition()
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-lake", daemon=True)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why the newest build failed, until one works again."""
        return "" if (failure := self._failure) is None else str(failure)

    def wake(self) -> None:
        """Build a newly sealed segment."""
        with self._state:
            self._is_wanted = True
            self._state.notify_all()

    def close(self) -> None:
        """Build everything that is sealed, and stop; StoreError if that fails."""
        with self._state:
            self._closing = self._is_wanted = True
            self._state.notify_all()
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def wait_until_caught_up(self) -> None:
        """Wait until what was sealed before the start is in the lake; StoreError if that fails."""
        self._caught_up.wait()
        if self._failure is not None:
            raise self._failure

    def _loop(self) -> None:
        be_nicer(_NICER)  # samples are acknowledged, pages answered first
        reported = ""
        while True:
            with self._state:
                if not self._is_wanted and not self._closing:
                    self._state.wait(_RETRY_S if self._failure is not None else None)
                is_last, self._is_wanted = self._closing, False
            self._failure = self._build()
            self._caught_up.set()
            if self.trouble not in {"", reported}:
                self._on_warning(self.trouble)
            reported = self.trouble
            if is_last:
                return

    def _build(self) -> StoreError | None:
        try:
            with builder_lock(self._store):
                deque(build_missing(self._store), maxlen=0)
        except LakeBusy:
            return None  # the other builder builds it
        except StoreError as error:
            return error
        except Exception as error:  # noqa: BLE001  recording continues, and it is retried
            return StoreError(
                f"the lake of {self._store.folder} cannot be written: {error}; the log is complete, the lake is built "
                "from it once that is repaired"
            )
        return None
