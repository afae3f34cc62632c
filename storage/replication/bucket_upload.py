"""A plant's sealed segments and files in a bucket, each uploaded once, from where fleet stores fetch them."""

import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import msgspec

from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, LOST
from storage.object_lake.bucket import Bucket, FileDigests, Outdated, file_digests
from storage.replication.addresses import recall_command
from storage.replication.arriving.bandwidth import Bandwidth
from storage.replication.plant_list import SALVAGED, ListRefused, checked_line
from storage.replication.progress import Refusal
from storage.replication.sources.folder_source import FolderSource
from storage.replication.sources.plant_bucket import FILES, SEGMENTS, BucketList, claim, file_key, segment_key
from storage.replication.sources.source import CarriedFile, SourceGone
from stream.decoding import decode_json
from stream.errors import BadInput, StoreError

_LISTED_EVERY_S = 5.0  # what is uploaded is seen by others so soon


class Uploaded(msgspec.Struct, frozen=True, kw_only=True):
    """What a pass has uploaded; `segments` are listed in the bucket. `trouble` is why it ended early."""

    plant: str = ""
    to: str
    segments: int = 0
    added: int = 0
    added_bytes: int = 0
    added_files: int = 0
    refused: tuple[Refusal, ...] = ()
    notes: tuple[str, ...] = ()
    trouble: str = ""

    @property
    def is_well(self) -> bool:
        """Whether nothing was refused and the pass came to its end."""
        return not self.refused and not self.trouble


class BucketUpload:
    """Passes for one plant; an object that is listed is never replaced.

    Parameters
    ----------
    source : FolderSource
        The plant.
    bucket : Bucket
        The prefix that is the plant's.
    bandwidth : Bandwidth
        The limit.
    on_bytes : callable
        Gets the size of each segment or file that is uploaded.
    stopped : callable
        Whether the pass is to end.
    """

    def __init__(
        self, source: FolderSource, bucket: Bucket, *, bandwidth: Bandwidth | None = None,
        on_bytes: Callable[[int], object] = lambda _size: None, stopped: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        self._source, self._bucket, self._bandwidth = source, bucket, bandwidth or Bandwidth()
        self._on_bytes, self._stopped = on_bytes, stopped
        self._list, self._file_list = BucketList(bucket, SEGMENTS), BucketList(bucket, FILES)
        self._there: dict[str, str] | None = None  # entity tags of the objects of segments, once they were listed
        self._listed: set[str] = set()
        self._files: set[str] = set()
        self._listed_files = 0
        self._begin()

    def _begin(self) -> None:
        self._plant = ""
        self._added = self._added_bytes = self._added_files = self._count = 0
        self._refused: list[Refusal] = []
        self._notes: list[str] = []

    def run(self) -> Uploaded:
        """Upload what the bucket lacks."""
        self._begin()
        trouble = ""
        try:
            plant = self._source.plant()
            if plant is None:
                self._notes.append(f"{self._source.where} has no sealed segment yet")
            else:
                self._plant = plant.name
                claim(self._bucket, plant)
                self._continue_list()
                self._bring_files()
        except Outdated as error:
            trouble = f"{self._bucket.url}/{error} was written by another upload of this plant; repeat the command"
        except ListRefused as error:
            self._refuse(error.kind, error.segment, str(error))
        except (SourceGone, StoreError, BadInput) as error:
            trouble = str(error)
        except _Stopped:
            trouble = "stopped; the next pass resumes"
        return Uploaded(
            plant=self._plant, to=self._bucket.url, segments=self._count, added=self._added,
            added_bytes=self._added_bytes, added_files=self._added_files, refused=tuple(self._refused),
            notes=tuple(self._notes), trouble=trouble,
        )  # fmt: skip

    def _continue_list(self) -> None:
        """Upload the segments of lines that the bucket lacks, then list them."""
        self._list.update()
        held = self._count = self._list.count
        own = list(self._source.segments(max(0, held - 1)))
        is_rewritten = False
        if held and (not own or own[0] != self._list.last_line):
            own = list(self._source.segments(0))
            theirs = list(self._list.lines())
            self._check_same_history(theirs, own)
            if theirs[: len(own)] == own:
                raise StoreError(
                    f"the list of {self._source.where} ends before the one in {self._bucket.url}: it was replaced by "
                    "an older copy, or its disk has lost the end; "
                    f"{recall_command(self._bucket.url, self._source.where, endpoint_url=self._bucket.endpoint_url)} "
                    "brings it back"
                )
            is_rewritten, held = True, 0
        elif held:
            own = own[1:]
        entries = self._entries(own, held, is_rewritten)
        latest = {each.segment: each for each in entries if each.origin != LOST}
        for entry in self._listed_and_missing():
            self._upload(latest.get(entry.segment, entry))
        if is_rewritten:
            for entry in latest.values():
                self._upload(entry)
            self._list.replace(own)
            self._count = len(own)
            self._notes.append("the plant has rewritten its list")
            return
        listed_at, first = time.monotonic(), held
        for number, entry in enumerate(entries, start=held + 1):
            if entry.origin != LOST:
                self._upload(latest[entry.segment])
            if number == held + len(own) or time.monotonic() - listed_at > _LISTED_EVERY_S:
                self._list.append(first, own[first - held : number - held])
                self._listed.update(each.segment for each in entries[first - held : number - held])
                listed_at, first = time.monotonic(), number
                self._count = number

    def _check_same_history(self, theirs: list[bytes], own: list[bytes]) -> None:
        """Raise ListRefused if the plant's list lacks or changes what the bucket's has; StoreError if that is none."""
        last, listed = FIRST, dict[str, SegmentEntry]()
        for number, line in enumerate(theirs, start=1):
            try:
                checked = checked_line(line, last)
            except ListRefused as error:
                raise StoreError(
                    f"line {number:,} of the list in {self._bucket.url} is no line of a plant; it was changed: "
                    f"delete the objects below {SEGMENTS}/ there, the list is then uploaded again"
                ) from error
            last = checked.chained
            if checked.entry.origin != LOST:
                listed.setdefault(checked.entry.segment, checked.entry)
        mine, lost = dict[str, SegmentEntry](), set[str]()
        for entry in map(_entry, own):
            if entry.origin == LOST:
                lost.add(entry.segment)
            else:
                mine.setdefault(entry.segment, entry)
        if len(own) < len(theirs) and theirs[: len(own)] == own:
            return  # it is shorter
        for name, entry in listed.items():
            found = mine.get(name)
            if found is None and name in lost:
                continue
            if found is None or (found.sha256 != entry.sha256 and found.origin != SALVAGED):
                what = "is not in it" if found is None else f"has SHA-256 {found.sha256[:12]} in it"
                raise ListRefused(
                    "fork", name,
                    f"the list of {self._source.where} has another history than the one in {self._bucket.url}: "
                    f"segment {name}, listed there with SHA-256 {entry.sha256[:12]}, {what}; nothing is uploaded",
                )  # fmt: skip

    def _entries(self, own: list[bytes], held: int, is_rewritten: bool) -> list[SegmentEntry]:
        """What the plant's lines list; ListRefused if they do not continue the bucket's list."""
        last, found = FIRST, []
        if held and not is_rewritten:
            last = self._list.last_line.rpartition(b"\t")[2].decode()
        for raw in own:
            line = checked_line(raw, last)
            last = line.chained
            found.append(line.entry)
        return found

    def _listed_and_missing(self) -> list[SegmentEntry]:
        """At the first pass: listed segments without an object, which were damaged or missing before."""
        if self._there is not None:
            return []
        objects = self._bucket.objects("log")
        self._there = {each.key: each.etag for each in objects}
        sizes: defaultdict[str, set[int]] = defaultdict(set)
        found: dict[str, SegmentEntry] = {}
        for line in self._list.lines():
            entry = _entry(line)
            self._listed.add(entry.segment)
            found[entry.segment] = entry
            sizes[segment_key(entry.segment)].add(entry.size)
        for each in objects:
            if each.key in sizes and each.bytes not in sizes[each.key]:  # somebody has changed it
                self._notes.append(f"{self._bucket.url}/{each.key} has {each.bytes:,} bytes, it is uploaded again")
                del self._there[each.key]
        return [each for name, each in found.items() if each.origin != LOST and segment_key(name) not in self._there]

    def _upload(self, entry: SegmentEntry) -> None:
        """Upload a segment that is not there; what is listed stays, whatever the plant has left of it."""
        assert self._there is not None
        name, key = entry.segment, segment_key(entry.segment)
        if key in self._there and name in self._listed:
            return
        path = self._source.store.log / name
        try:
            digests = file_digests(path)
        except OSError as error:
            self._refuse("segment_missing", name, f"{path} cannot be read: {error}")
            return
        if digests.sha256 != entry.sha256:
            what = f"{name} has SHA-256 {digests.sha256[:12]}, it is listed with {entry.sha256[:12]}: not uploaded"
            self._refuse("bad_hash", name, what)
        elif self._there.get(key) != digests.etag:  # else a pass was cut off before it could list it
            self._put(key, path, digests)
            self._there[key] = digests.etag
            self._added += 1
            self._added_bytes += digests.bytes

    def _refuse(self, kind: str, name: str, what: str) -> None:
        refusal = Refusal(self._plant, kind, name, what)
        if refusal not in self._refused:
            self._refused.append(refusal)

    def _bring_files(self) -> None:
        self._file_list.update()
        for line in self._file_list.lines(self._listed_files):
            self._files.add(decode_json(line, CarriedFile).name)
            self._listed_files += 1
        fresh = [each for each in self._source.files() if each.name not in self._files]
        for each in fresh:
            if self._stopped():
                raise _Stopped
            path = self._source.store.folder / each.name
            self._put(file_key(each.name), path, file_digests(path))
            self._file_list.append(self._listed_files, [msgspec.json.encode(each)])
            self._files.add(each.name)
            self._listed_files += 1
            self._added_files += 1

    def _put(self, key: str, path: Path, digests: FileDigests) -> None:
        self._bandwidth.take(digests.bytes)
        if self._stopped():
            raise _Stopped
        self._bucket.put_file(key, path, digests)
        self._on_bytes(digests.bytes)


def _entry(line: bytes) -> SegmentEntry:
    try:
        return decode_json(line.partition(b"\t")[0], SegmentEntry)
    except msgspec.MsgspecError as error:
        raise StoreError(f"a line of the list is none: {line[:60]!r} ({error})") from error


class _Stopped(Exception):
    """The pass is to end now; the next one resumes."""
