"""The lake made in the background of a recorder, from segments as they are sealed."""

import threading
from collections.abc import Callable

from storage.lake.lake import LakeBusy, build_missing, builder_lock
from storage.store import Store
from stream.errors import StoreError

_RETRY_S = 10.0


class LakeBuilder:
    """A thread that brings sealed segments to the lake.

    Parameters
    ----------
    store: Whose.
    on_lake: Called with the name of each segment that has reached the lake.
    on_warning: Called with why a segment cannot be brought there; it is tried again.
    """

    def __init__(
        self,
        store: Store,
        *,
        on_lake: Callable[[str], None] | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        self._store = store
        self._on_lake = on_lake
        self._on_warning = on_warning
        self._failure: StoreError | None = None
        self._is_wanted = True  # whatever an earlier process sealed and did not bring there
        self._closing = False
        self._caught_up = threading.Event()
        self._state = threading.Condition()
        self._thread = threading.Thread(target=self._loop, name="gyrofleet-lake", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """A segment was sealed."""
        with self._state:
            self._is_wanted = True
            self._state.notify_all()

    def close(self) -> None:
        """Bring there what is sealed, and stop."""
        with self._state:
            self._closing = self._is_wanted = True
            self._state.notify_all()
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def wait_until_caught_up(self) -> None:
        """Wait until what was sealed before the start is there."""
        self._caught_up.wait()
        if self._failure is not None:
            raise self._failure

    def _loop(self) -> None:
        told = ""
        while True:
            with self._state:
                if not self._is_wanted and not self._closing:
                    self._state.wait(_RETRY_S if self._failure is not None else None)
                is_last, self._is_wanted = self._closing, False
            self._failure = self._build()
            self._caught_up.set()
            if self._failure is not None and str(self._failure) != told and self._on_warning is not None:
                told = str(self._failure)
                self._on_warning(told)
            if is_last:
                return

    def _build(self) -> StoreError | None:
        try:
            with builder_lock(self._store):
                for name in build_missing(self._store):
                    if self._on_lake is not None:
                        self._on_lake(name)
        except LakeBusy:
            return None  # whoever is at it brings there what is sealed
        except StoreError as error:
            return error
        except Exception as error:  # noqa: BLE001  whatever it is, recording goes on, and it is tried again
            return StoreError(
                f"the lake of {self._store.folder} cannot be written: {error}; the log is complete, the lake is made "
                "from it when that is mended"
            )
        return None
