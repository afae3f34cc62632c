"""A plant that is served at an endpoint of the bus; see `bus_server`."""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

import msgspec

from storage.manifests.entries import SegmentEntry
from storage.plant import Plant, checked
from storage.replication.sources.bus_server import KEYS, MISSING, After, Range
from storage.replication.sources.source import CHUNK_BYTES, CarriedFile, SegmentMissing, SourceGone
from stream.closing import Closing
from stream.decoding import decode_json
from stream.errors import BadInput, BusError
from stream.transport.zenoh_bus import Answers, Refused, ZenohBus

_TIMEOUT_S = 10.0
_ATTEMPTS = 3
_PAUSE_S = 0.7
_AHEAD = 4  # ranges that are asked for before they are read, for lines with a long delay


class BusSource(Closing):
    """A plant at an endpoint; without a name the only one that answers there.

    The link is opened when it is first needed, and again when it was lost.
    """

    def __init__(self, endpoint: str, name: str | None = None) -> None:
        self.where, self._name = endpoint, name
        self._bus: ZenohBus | None = None
        self._ahead: deque[tuple[Range, Answers]] = deque()

    def plant(self) -> Plant | None:
        """Identity of the plant."""
        self._ahead.clear()
        found: set[bytes] = set()
        for attempt in range(_ATTEMPTS):
            if attempt:
                time.sleep(_PAUSE_S)
            found = {content for _, content in self._answers(f"{KEYS}/{self._name or '*'}/plant", b"")}
            if found:
                break
        else:
            raise SourceGone(f"no plant{f' {self._name}' if self._name else ''} answers")
        try:
            plants = [checked(decode_json(each, Plant)) for each in found]
        except msgspec.MsgspecError as error:
            raise BadInput(f"the identity that is stated cannot be read: {error}") from error
        if len(plants) > 1:
            listed = ", ".join(sorted(each.name for each in plants))
            raise BadInput(f"several plants answer ({listed}); give --plant NAME")
        if self._name not in (None, plants[0].name):
            raise BadInput(f"plant {plants[0].name} answers for plant {self._name}")
        self._name = plants[0].name
        return plants[0]

    def segments(self, after: int) -> Iterator[bytes]:
        """Lines of its list beyond the first `after`."""
        while True:
            lines = self._answer("list", After(after)).split(b"\n")[:-1]
            if not lines:
                return
            yield from lines
            after += len(lines)

    def originals(self) -> tuple[SegmentEntry, ...]:
        """None: a plant has what it lists last."""
        return ()

    def files(self) -> Iterator[CarriedFile]:
        """What travels besides segments."""
        after = 0
        while True:
            content = self._answer("files", After(after))
            try:
                found = decode_json(content, list[CarriedFile])
            except msgspec.MsgspecError as error:
                raise SourceGone(f"its list of files cannot be read: {error}") from error
            if not found:
                return
            yield from found
            after += len(found)

    def read(self, name: str, offset: int, length: int) -> bytes:
        """A range of a segment or file; those after it are asked for meanwhile."""
        if not self._ahead or (self._ahead[0][0].name, self._ahead[0][0].offset) != (name, offset):
            self._ahead.clear()
        if length == CHUNK_BYTES:  # else the end of a file, or a limit of bandwidth
            while len(self._ahead) < _AHEAD:
                following = self._ahead[-1][0].offset + CHUNK_BYTES if self._ahead else offset
                asked = Range(name, following, CHUNK_BYTES)
                self._ahead.append((asked, self._asked("read", asked)))
        with suppress(IndexError):
            found = self._received(self._ahead.popleft()[1])
            if found is not None:
                return found[:length]
        return self._answer("read", Range(name, offset, length))

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _answer(self, what: str, request: After | Range) -> bytes:
        for attempt in range(_ATTEMPTS):
            if attempt:
                time.sleep(_PAUSE_S)  # a link that was cut is opened again
            found = self._received(self._asked(what, request))
            if found is not None:
                return found
        raise SourceGone(f"plant {self._name} does not answer at {self.where}; the next pass resumes")

    def _received(self, answers: Answers) -> bytes | None:
        """The first answer; None if there is none in time."""
        try:
            found = answers.all()
        except Refused as error:
            if str(error).startswith(MISSING):
                raise SegmentMissing(str(error).removeprefix(MISSING)) from error
            raise SourceGone(str(error)) from error
        return found[0][1] if found else None

    def _asked(self, what: str, request: After | Range) -> Answers:
        try:
            return self._opened().ask(f"{KEYS}/{self._name}/{what}", msgspec.json.encode(request), _TIMEOUT_S)
        except BusError as error:
            raise SourceGone(str(error)) from error

    def _answers(self, key: str, payload: bytes) -> list[tuple[str, bytes]]:
        try:
            return self._opened().ask(key, payload, _TIMEOUT_S, asks_all=True).all()
        except BusError as error:
            raise SourceGone(str(error)) from error

    def _opened(self) -> ZenohBus:
        if self._bus is None:
            self._bus = ZenohBus(connect=[self.where])
        return self._bus
