"""Lines of TCP that neither wait for ever nor become too many: slow requests, slow readers, crowds."""

import asyncio
import resource

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from analytics.serve.doors.watch import Watch

_MOST = 2000
# so much is read and dropped, so that a client which sends first and reads then sees its answer
_MOST_UNREAD_BYTES = 8 << 20


class Line(H11Protocol):
    """A connection.

    One that has sent no whole head of a request after `head_s` is closed, one whose reader takes nothing for `read_s`
    as well. Where there are more than `most`, the one that has waited longest makes room; who is being answered stays.
    """

    watch: Watch
    most = _MOST
    head_s = 20.0
    read_s = 60.0
    waits_since_s = 0.0
    _unread_bytes = 0
    _head: asyncio.TimerHandle | None = None
    _read: asyncio.TimerHandle | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.waits_since_s = self.loop.time()
        self._head = self.loop.call_later(self.head_s, self._look)
        if len(self.connections) > self.most:
            self._make_room()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        for timer in (self._head, self._read):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come; a body that goes on long after its answer ends the connection."""
        if self.is_waiting and self.conn.their_state is h11.SEND_BODY:
            self._unread_bytes += len(data)
            if self._unread_bytes > _MOST_UNREAD_BYTES:
                self.end("its request goes on after the answer")
                return
        super().data_received(data)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self.waits_since_s = self.loop.time()
        self._unread_bytes = 0
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Wait for the reader."""
        super().pause_writing()
        self._read = self.loop.call_later(self.read_s, self.end, "its reader takes nothing")

    def resume_writing(self) -> None:
        """Wait for the reader no more."""
        if self._read is not None:
            self._read.cancel()
        super().resume_writing()

    def end(self, why: str) -> None:
        """Close it at once, and report why."""
        if not self.transport.is_closing():
            self.watch.saw("line closed", str(self.client[0]) if self.client else "unknown", why)
            self.transport.abort()

    def _look(self) -> None:
        left_s = self.waits_since_s + self.head_s - self.loop.time()
        if self.is_waiting and left_s <= 0.0:
            self.end("no whole request has come")
        else:
            self._head = self.loop.call_later(left_s if self.is_waiting else self.head_s, self._look)

    def _make_room(self) -> None:
        waiting = [each for each in self.connections if isinstance(each, Line) and each.is_waiting]
        longest = min(waiting, key=lambda each: each.waits_since_s, default=self)
        longest.end(f"there are more than {self.most} connections")


def line_class(watch: Watch) -> type[Line]:
    """The class of a server's connections; at most half of the files that this process may open."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _MOST if files == resource.RLIM_INFINITY else min(_MOST, files // 2)
    return type("ServerLine", (Line,), {"watch": watch, "most": most})
