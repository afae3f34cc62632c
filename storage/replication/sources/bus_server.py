"""A plant served over the bus: its identity, its list, its files, and ranges of bytes, to whoever asks.

Requests are ``gyrofleet/@replication/PLANT/WHAT``. Nothing is written; no other file of the store can be asked for.
"""

import json

import msgspec

from storage.plant import Plant
from storage.replication.sources.folder_source import FolderSource
from storage.replication.sources.source import CHUNK_BYTES, CarriedFile, SegmentMissing
from stream.decoding import json_decoder
from stream.errors import BadInput, StoreError
from stream.identity import ROOT
from stream.transport.zenoh_bus import ZenohBus

KEYS = f"{ROOT}/@replication"
MISSING = "missing: "
_LIST_BYTES = 1 << 20
_FILES_AT_ONCE = 1_000


class Range(msgspec.Struct, frozen=True):
    """A request for bytes of a segment or file."""

    name: str
    offset: int
    length: int


class After(msgspec.Struct, frozen=True):
    """A request for lines or files beyond the first `after`."""

    after: int


_range = json_decoder(Range)
_after = json_decoder(After)


class PlantServer:
    """Answers for one plant on a bus.

    Raises StoreError if the store has no sealed segment yet, and so no identity.
    """

    def __init__(self, bus: ZenohBus, source: FolderSource) -> None:
        self._source = source
        self._files: list[CarriedFile] = []
        plant = source.plant()
        if plant is None:
            raise StoreError(f"{source.where} has no sealed segment yet, and so no identity; record something first")
        self.plant: Plant = plant
        # apart from each other: a long list does not hold up ranges
        for what in ("plant", "list", "files", "read"):
            bus.answer(f"{KEYS}/{plant.name}/{what}", self._answer)

    def _answer(self, key: str, payload: bytes) -> bytes:
        what = key.rpartition("/")[2]
        try:
            if what == "plant":
                return msgspec.json.encode(self.plant)
            if what == "list":
                return self._lines(_after.decode(payload).after)
            if what == "files":
                return self._listed_files(_after.decode(payload).after)
            return self._bytes(_range.decode(payload))
        except msgspec.MsgspecError as error:
            raise BadInput(f"the request cannot be read: {error}") from error
        except SegmentMissing as error:
            raise BadInput(f"{MISSING}{error}") from error

    def _lines(self, after: int) -> bytes:
        lines, size = [], 0
        for line in self._source.segments(max(0, after)):
            lines.append(line + b"\n")
            size += len(line)
            if size >= _LIST_BYTES:
                break
        return b"".join(lines)

    def _listed_files(self, after: int) -> bytes:
        if after <= 0:
            self._files = list(self._source.files())
        return msgspec.json.encode(self._files[max(0, after) : max(0, after) + _FILES_AT_ONCE])

    def _bytes(self, wanted: Range) -> bytes:
        if wanted.offset < 0 or not 0 <= wanted.length <= CHUNK_BYTES:
            raise BadInput(f"at most {CHUNK_BYTES:,} bytes are sent at once: {json.dumps(msgspec.to_builtins(wanted))}")
        return self._source.read(wanted.name, wanted.offset, wanted.length)
