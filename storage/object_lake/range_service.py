"""Ranges of files, served by one process to a sandboxed one over sockets that it inherits.

The process that asks has neither network nor credentials nor the cache: it can name files of one lake, and gets bytes.
"""

import socket
import struct
import threading
from collections.abc import Callable
from queue import SimpleQueue

from stream.closing import Closing
from stream.errors import GyrofleetError, StoreError

AT_ONCE = 4
_ASKED = struct.Struct("<HQQ")  # length of the name, offset and length of the range
_ANSWERED = struct.Struct("<?Q")  # whether it is an error, and its length
_MOST_BYTES = 1 << 31

Read = Callable[[str, int, int], bytes]


class RangeService(Closing):
    """Answers requests at the near ends of socket pairs; `far_ends` are those that the other process inherits."""

    def __init__(self, read: Read) -> None:
        self._read = read
        pairs = [socket.socketpair() for _ in range(AT_ONCE)]
        self._near = [near for near, _ in pairs]
        self.far_ends = [far for _, far in pairs]
        self._threads = [threading.Thread(target=self._serve, args=(each,), daemon=True) for each in self._near]
        for thread in self._threads:
            thread.start()

    def handed_over(self) -> None:
        """Close the far ends here, once the other process has them: these threads then end with it."""
        for each in self.far_ends:
            each.close()

    def close(self) -> None:
        """End."""
        self.handed_over()
        for each in self._near:
            with_error = each
            try:
                with_error.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        for thread in self._threads:
            thread.join()
        for each in self._near:
            each.close()

    def _serve(self, near: socket.socket) -> None:
        with near.makefile("rb") as requests:
            while len(head := requests.read(_ASKED.size)) == _ASKED.size:
                named, offset, length = _ASKED.unpack(head)
                name = requests.read(named).decode(errors="replace")
                try:
                    if length > _MOST_BYTES:
                        raise StoreError(f"{name}: {length} bytes at a time are too many")
                    content, is_error = self._read(name, offset, length), False
                except GyrofleetError as error:
                    content, is_error = str(error).encode(), True
                try:
                    near.sendall(_ANSWERED.pack(is_error, len(content)))
                    near.sendall(content)
                except OSError:
                    return  # the other process has ended


class RangeClient:
    """The other end, in the process that asks."""

    def __init__(self, descriptors: list[int]) -> None:
        self._free: SimpleQueue[socket.socket] = SimpleQueue()
        for each in descriptors:
            self._free.put(socket.socket(fileno=each))

    def read(self, name: str, offset: int, length: int) -> bytes:
        """Bytes of a file; StoreError if they cannot be had."""
        far = self._free.get()
        try:
            encoded = name.encode()
            far.sendall(_ASKED.pack(len(encoded), offset, length) + encoded)
            is_error, size = _ANSWERED.unpack(_exactly(far, _ANSWERED.size))
            content = _exactly(far, size)
        finally:
            self._free.put(far)
        if is_error:
            raise StoreError(content.decode())
        return bytes(content)


def _exactly(far: socket.socket, length: int) -> bytearray:
    content = bytearray(length)
    view = memoryview(content)
    while view:
        got = far.recv_into(view)
        if not got:
            raise StoreError("the process that reads the lake has ended")
        view = view[got:]
    return content
