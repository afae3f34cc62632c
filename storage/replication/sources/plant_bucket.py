"""A plant's history in a bucket: its identity, its segments and files, and lists that are only ever continued.

``plant.json``, ``log/00000001.mcap``, ``files/models/...``, and the lists ``list/0001/...`` and ``file-list/0001/...``.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

import msgspec

from storage.object_lake.bucket import Bucket, Outdated
from storage.plant import Plant
from stream.decoding import decode_json
from stream.errors import StoreError

SEGMENTS, FILES = "list", "file-list"
_PLANT = "plant.json"
_LINES = 10_000  # of an object
_PIECE = re.compile(r"(?P<generation>\d{4})/(?P<first>\d{12})\.jsonl")


class BucketList:
    """Lines in objects that are created once and never replaced; an object is named by the number of its first line.

    A list that a plant has rewritten, as its `gyrofleet recover` does, is a new generation beside the old one.
    """

    def __init__(self, bucket: Bucket, folder: str) -> None:
        self._bucket, self._folder = bucket, folder
        self.generation = 1
        self._firsts: list[int] = []  # of the objects of this generation
        self._seen = ""  # the last key
        self._latest: tuple[str, list[bytes]] = ("", [])  # object that was read last; none ever changes

    def update(self) -> None:
        """Look for objects that were added."""
        pieces: dict[int, list[int]] = {}
        for each in self._bucket.objects(self._folder, after=self._seen):
            name = each.key.removeprefix(f"{self._folder}/")
            if (match := _PIECE.fullmatch(name)) is not None:
                pieces.setdefault(int(match["generation"]), []).append(int(match["first"]))
                self._seen = max(self._seen, each.key)
        # the first object of a rewritten list is created last: before it the old list holds
        whole = max((each for each, firsts in pieces.items() if 0 in firsts), default=self.generation)
        if whole > self.generation:
            self.generation, self._firsts = whole, []
        self._firsts = sorted({*self._firsts, *pieces.get(self.generation, ())})

    def lines(self, after: int = 0) -> Iterator[bytes]:
        """Lines beyond the first `after`; StoreError if there is a gap."""
        for first, following in pairwise([*self._firsts, None]):
            assert first is not None
            if following is not None and following <= after:
                continue
            found = self._piece(first)
            if following is not None and first + len(found) != following:
                raise StoreError(
                    f"{self._bucket.url}/{self._key(first)} has {len(found):,} lines, and the next begins with line "
                    f"{following:,}: objects of the list are missing or changed"
                )
            yield from found[max(0, after - first) :]

    def earlier(self) -> Iterator[list[bytes]]:
        """The lists that this one has replaced, the oldest first."""
        for generation in range(1, self.generation):
            old = BucketList(self._bucket, self._folder)
            keys = [each.key for each in self._bucket.objects(f"{self._folder}/{generation:04d}")]
            names = [_PIECE.fullmatch(key.removeprefix(f"{self._folder}/")) for key in keys]
            old.generation, old._firsts = generation, sorted(int(each["first"]) for each in names if each is not None)
            yield list(old.lines())

    @property
    def is_empty(self) -> bool:
        """Whether it has no object."""
        return not self._firsts

    @property
    def count(self) -> int:
        """Number of lines."""
        return self._firsts[-1] + len(self._piece(self._firsts[-1])) if self._firsts else 0

    @property
    def last_line(self) -> bytes:
        """The last line; empty where there is none."""
        return self._piece(self._firsts[-1])[-1] if self._firsts else b""

    def append(self, first: int, lines: Sequence[bytes]) -> None:
        """Continue the list with line number `first`; Outdated if somebody else has done so."""
        for at in range(0, len(lines), _LINES):
            self._create(first + at, lines[at : at + _LINES])

    def replace(self, lines: Sequence[bytes]) -> None:
        """Begin a new generation with all lines; it holds once its first object, the last one created, is there."""
        self.generation += 1
        self._firsts = []
        for at in reversed(range(0, len(lines), _LINES)):
            self._create(at, lines[at : at + _LINES])
        self._firsts.sort()

    def _create(self, first: int, lines: Sequence[bytes]) -> None:
        key, content = self._key(first), b"".join(line + b"\n" for line in lines)
        try:
            self._bucket.put_if(key, content, None)
        except Outdated:  # as where an answer was lost and the request repeated
            found = self._bucket.get(key)
            if found is None or found[0] != content:
                raise
        self._firsts.append(first)
        self._seen = max(self._seen, key)

    def _piece(self, first: int) -> list[bytes]:
        key = self._key(first)
        if self._latest[0] == key:
            return self._latest[1]
        found = self._bucket.get(key)
        if found is None or not found[0].endswith(b"\n"):
            raise StoreError(
                f"{self._bucket.url}/{self._key(first)} is missing, or no list of lines: it was changed; delete "
                "what the plant has not written, or all objects of the list, and let the plant upload again"
            )
        self._latest = key, found[0].split(b"\n")[:-1]
        return self._latest[1]

    def _key(self, first: int) -> str:
        return f"{self._folder}/{self.generation:04d}/{first:012d}.jsonl"


def read_claim(bucket: Bucket) -> Plant | None:
    """The plant whose history a bucket holds; None if it is of none yet."""
    found = bucket.get(_PLANT)
    if found is None:
        return None
    try:
        return decode_json(found[0], Plant)
    except msgspec.MsgspecError as error:
        raise StoreError(f"{bucket.url}/{_PLANT} is no identity of a plant: {error}") from error


def claim(bucket: Bucket, plant: Plant) -> None:
    """Make a bucket that of a plant; StoreError if it is another's."""
    holder = read_claim(bucket)
    if holder is None:
        try:
            bucket.put_if(_PLANT, msgspec.json.encode(plant), None)
        except Outdated:
            holder = read_claim(bucket)
    if holder is not None and holder != plant:
        raise StoreError(
            f"{bucket.url} has the history of plant {holder.name} (store {holder.store[:12]}), not of {plant.name} "
            f"(store {plant.store[:12]}): give each plant a prefix of its own"
        )


def segment_key(name: str) -> str:
    """Key of a segment."""
    return f"log/{name}"


def file_key(name: str) -> str:
    """Key of a file that travels."""
    return f"files/{name}"
