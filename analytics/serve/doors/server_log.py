"""Warnings of the HTTP library among the events of the doors: limited as those are, since anybody can cause them."""

import logging
import traceback

from analytics.serve.doors.watch import Watch


class WatchedLog(logging.Handler):
    """Hands records of a logger to a watch."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(logging.WARNING)
        self._watch = watch

    def emit(self, record: logging.LogRecord) -> None:
        """Report a record; one of an error with its traceback, which tells what to mend."""
        if record.exc_info is None or record.exc_info[1] is None:
            self._watch.saw("http", "the server", record.getMessage())
            return
        self._watch.failed("".join(traceback.format_exception(record.exc_info[1])))


def watch_log(watch: Watch) -> None:
    """Have a watch report what the HTTP library logs."""
    logger = logging.getLogger("uvicorn.error")
    logger.handlers = [WatchedLog(watch)]
    logger.propagate = False
