"""Uploads of parts: into folders that no other upload has, each file verified, resumed after a kill.

The name of a folder ends in a token that is drawn for one upload and never used again. Whatever becomes of an upload,
it cannot touch what is in force, and a delayed request cannot damage a later one.
"""

import hashlib
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path
from uuid import uuid4

import msgspec

from storage.manifests.part import PART, Part, sealed
from storage.object_lake.bucket import Bucket, file_digests
from storage.object_lake.published import PARTS
from storage.store import Store
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import write_durably

FOLDER = "published"
"""Folder of the store with what is known of uploads that are not in force yet."""
ABANDONED_AFTER = timedelta(hours=24)
"""Age of objects that no manifest names, after which any builder removes them."""
_YOUNG_NS = 12 * 3600 * 10**9  # an upload is begun again before others may take it for abandoned
_FILES_AT_ONCE = 4


class Upload(msgspec.Struct, frozen=True):
    """An upload that was begun, by the server's clock."""

    token: str
    begun_ns: int


class Uploads:
    """Uploads of one store to one address. `clock_ns` is the server's time."""

    def __init__(self, store: Store, bucket: Bucket, clock_ns: Callable[[], int]) -> None:
        self._bucket, self._clock_ns = bucket, clock_ns
        self._path = store.folder / FOLDER / f"{hashlib.sha256(bucket.url.encode()).hexdigest()[:16]}.json"
        self._begun: dict[str, Upload] = {}
        try:
            self._begun = decode_json(self._path.read_bytes(), dict[str, Upload])
        except (FileNotFoundError, msgspec.MsgspecError):
            self._begun = {}  # uploads begin again; what is there is removed as abandoned

    def upload(self, part: Part, folder: Path, on_bytes: Callable[[int], None] = lambda _: None) -> Part:
        """Upload the files of a part and verify each; returns the part as it is published.

        What an interrupted upload of the same part left is not sent again. StoreError if a local file is damaged.
        """
        digest = _digest(part)
        upload = self._begun.get(digest)
        if upload is None or not self._is_young(upload):
            self._begun[digest] = upload = Upload(uuid4().hex[:12], self._clock_ns())
            self._save()
            there: dict[str, tuple[int, str]] = {}
        else:
            place = f"{PARTS}/{part.name}.{upload.token}/"
            there = {found.key.removeprefix(place): (found.bytes, found.etag) for found in self._bucket.objects(place)}
        published = msgspec.structs.replace(part, name=f"{part.name}.{upload.token}")
        place = f"{PARTS}/{published.name}"

        def send(name: str) -> None:
            file, path = part.files[name], folder / name
            try:
                digests = file_digests(path)
            except OSError as error:
                raise StoreError(f"{path} cannot be read: {error}; `gyrofleet recover` rebuilds it") from error
            if (digests.bytes, digests.sha256) != (file.bytes, file.sha256):
                raise StoreError(f"{path} does not match its hash; `gyrofleet recover` rebuilds it from the log")
            if there.get(name) != (digests.bytes, digests.etag):
                self._bucket.put_file(f"{place}/{name}", path, digests)
                on_bytes(file.bytes)

        with ThreadPoolExecutor(_FILES_AT_ONCE) as pool:
            list(pool.map(send, part.files))
        self._bucket.put(f"{place}/{PART}", sealed(published))
        return published

    def are_young(self, published: Iterable[Part]) -> bool:
        """Whether uploads are so young that nobody takes them for abandoned while they are put in force."""
        begun = {upload.token: upload for upload in self._begun.values()}
        return all(self._is_young(begun[_token(part)]) for part in published if _token(part) in begun)

    def finish(self, published: Iterable[Part]) -> None:
        """Forget uploads that are in force: their folders are not written again."""
        done = {_token(part) for part in published}
        if done:
            self._begun = {digest: upload for digest, upload in self._begun.items() if upload.token not in done}
            self._save()

    def _is_young(self, upload: Upload) -> bool:
        return 0 <= self._clock_ns() - upload.begun_ns < _YOUNG_NS

    def _save(self) -> None:
        self._path.parent.mkdir(exist_ok=True)
        write_durably(self._path, msgspec.json.encode(self._begun))


def _token(published: Part) -> str:
    return published.name.rpartition(".")[2]


def _digest(part: Part) -> str:
    return hashlib.sha256(msgspec.json.encode(part)).hexdigest()[:24]
