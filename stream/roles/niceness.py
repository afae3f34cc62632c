"""Threads that work when others have nothing to do."""

import os
import sys
import threading
from contextlib import suppress


def be_nicer(by: int) -> None:
    """Lower the priority of this thread alone by steps of nice; nothing where threads have none of their own."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + by)
