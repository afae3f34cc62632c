"""A bucket of an object store with the S3 API: objects below one prefix, with conditional puts.

Credentials, region and endpoint come from the usual environment (``AWS_*``); messages never show them.
"""

import hashlib
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple, TypeVar

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
from obstore.store import S3Store

from storage.object_lake.address import check_service, parse_bucket
from stream.errors import BadInput, StoreError
from stream.roles.patience import GivenUp, answered

T = TypeVar("T")
AT_ONCE = 8  # requests
_READS = 3  # attempts
_CHUNK_BYTES = 16 << 20  # larger files go up in pieces of this size
_STATUS = re.compile(r"status code: (\d+)")
_FAULTS = (
    (re.compile(r"ConnectionRefused|Connection refused"), "connection refused"),
    (re.compile(r"dns error|lookup address"), "the name of its host is not known"),
    (re.compile(r"\bTimeout\b|TimedOut|timed out"), "no answer in time"),  # retry_timeout is in every text
)
_CODE = re.compile(r"<Code>(\w+)</Code>")


class Outdated(Exception):
    """A conditional put found another version of the object than it expected."""


class Unanswered(StoreError):
    """A request that failed, or whose answer was lost: it may have had its effect."""


class StoredObject(NamedTuple):
    """An object: its key below the prefix, size, time of its last change by the server's clock, and entity tag."""

    key: str
    bytes: int
    changed: datetime
    etag: str


class FileDigests(NamedTuple):
    """Size and SHA-256 of a file, and the entity tag that most servers give it."""

    bytes: int
    sha256: str
    etag: str


class Bucket:
    """The objects below an address such as ``s3://bucket/prefix``.

    Parameters
    ----------
    url: The address.
    endpoint_url: Of the service; by default AWS_ENDPOINT_URL, else Amazon's of the region.
    timeout_s: Time of one request, and of each attempt of one.
    retries: Further attempts after errors of the server or the line.
    """

    def __init__(
        self, url: str, endpoint_url: str | None = None, *, timeout_s: float = 120.0, retries: int = 6
    ) -> None:
        address = parse_bucket(url)
        check_service(endpoint_url)
        self.url, self.endpoint_url = str(address), endpoint_url
        try:
            self._store = S3Store(
                address.bucket, prefix="/".join(address.parts) or None,
                client_options={"allow_http": True, "timeout": timedelta(seconds=timeout_s)},
                retry_config={"max_retries": retries, "retry_timeout": timedelta(seconds=timeout_s * (retries + 1))},
                config={} if endpoint_url is None else {"endpoint": endpoint_url},
            )  # fmt: skip
        except (BaseError, ValueError) as error:
            raise BadInput(f"{self.url} cannot be addressed: {_plain(error)}") from None

    def get(self, key: str) -> tuple[bytes, str] | None:
        """Content and entity tag of an object; None if there is none."""

        def whole() -> tuple[bytes, str]:
            found = obstore.get(self._store, key)
            return bytes(found.bytes()), found.meta["e_tag"] or ""

        try:
            return self._read(key, whole)
        except FileNotFoundError as error:
            if "NoSuchBucket" in str(error):
                raise StoreError(f"{self.url}: there is no such bucket; create it first") from None
            return None

    def get_range(self, key: str, start: int, length: int) -> bytes:
        """Bytes of an object; StoreError if it has fewer."""
        try:
            content = self._read(key, lambda: bytes(obstore.get_range(self._store, key, start=start, length=length)))
        except FileNotFoundError:
            raise StoreError(f"{self.url}/{key} is missing; if the lake has changed since, run it again") from None
        if len(content) != length:
            raise Unanswered(f"{self.url}/{key}: {len(content)} bytes came, {length} were asked for")
        return content

    def sha256(self, key: str) -> tuple[int, str]:
        """Size and SHA-256 of an object's content, which is read."""

        def digested() -> tuple[int, str]:
            digest, size = hashlib.sha256(), 0
            for piece in obstore.get(self._store, key).stream(min_chunk_size=1 << 20):
                digest.update(piece)
                size += len(piece)
            return size, digest.hexdigest()

        try:
            return self._read(key, digested)
        except FileNotFoundError:
            raise StoreError(f"{self.url}/{key} is missing") from None

    def put_if(self, key: str, content: bytes, etag: str | None) -> str:
        """Replace the version `etag` of an object, or create it (None); Outdated if there is another one.

        Returns the new version.
        """
        try:
            done = answered(
                lambda: obstore.put(self._store, key, content, mode="create" if etag is None else {"e_tag": etag})
            )
            return done["e_tag"] or ""
        except (AlreadyExistsError, PreconditionError):
            raise Outdated(key) from None
        except (BaseError, FileNotFoundError, GivenUp) as error:
            raise self._failed(key, error) from None

    def put(self, key: str, content: bytes) -> None:
        """Write an object."""
        try:
            answered(lambda: obstore.put(self._store, key, content, use_multipart=False))
        except (BaseError, FileNotFoundError, GivenUp) as error:
            raise self._failed(key, error) from None

    def put_file(self, key: str, path: Path, of: "FileDigests") -> None:
        """Upload a file, and verify what has arrived.

        The entity tag is the MD5 of what was stored on most servers, also of pieces; where it is not, the object is
        read back.
        """
        try:
            put = answered(lambda: obstore.put(
                self._store, key, path, chunk_size=_CHUNK_BYTES, max_concurrency=4,
                use_multipart=of.bytes > _CHUNK_BYTES,
            ))  # fmt: skip
        except (BaseError, FileNotFoundError, GivenUp) as error:
            raise self._failed(key, error) from None
        if put["e_tag"] != of.etag and self.sha256(key) != (of.bytes, of.sha256):
            raise Unanswered(f"{self.url}/{key} is not what was sent; repeat the command")

    def objects(self, prefix: str = "", *, after: str = "") -> list[StoredObject]:
        """Objects whose keys begin with `prefix`, a folder, and come after that key; without them all."""

        def listed() -> list[StoredObject]:
            return [
                StoredObject(each["path"], each["size"], each["last_modified"], each["e_tag"] or "")
                for found in obstore.list(self._store, prefix or None, offset=after or None)
                for each in found
            ]

        try:
            return self._read(prefix, listed)
        except FileNotFoundError as error:
            raise self._failed(prefix, error) from None

    def head(self, key: str) -> StoredObject:
        """An object, without its content; StoreError if there is none."""
        found = self.find(key)
        if found is None:
            raise StoreError(f"{self.url}/{key} is missing")
        return found

    def find(self, key: str) -> StoredObject | None:
        """An object, without its content; None if there is none."""
        try:
            found = self._read(key, lambda: obstore.head(self._store, key))
        except FileNotFoundError:
            return None
        return StoredObject(key, found["size"], found["last_modified"], found["e_tag"] or "")

    def delete(self, keys: list[str]) -> None:
        """Delete objects; those that do not exist are none."""
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(self._delete, keys))

    def _delete(self, key: str) -> None:
        try:
            answered(lambda: obstore.delete(self._store, key))
        except FileNotFoundError:
            return
        except (BaseError, GivenUp) as error:
            raise self._failed(key, error) from None

    def _read(self, key: str, action: Callable[[], T]) -> T:
        """The result of a request that reads, tried again where its answer breaks off: the client does not do that."""
        for left in reversed(range(_READS)):
            try:
                return answered(action)
            except GivenUp as error:
                raise self._failed(key, error) from None
            except BaseError as error:
                if not left or _STATUS.search(str(error)) is not None:
                    raise self._failed(key, error) from None
        raise AssertionError

    def _failed(self, key: str, error: Exception) -> StoreError:
        if isinstance(error, GivenUp):
            return Unanswered(f"{self.url}/{key}: no answer yet, and this process is to end; the next one goes on")
        return Unanswered(
            f"{self.url}/{key}: {_plain(error)}; check the network, the endpoint and the credentials in AWS_*, then "
            f"repeat the command"
        )


def file_digests(path: Path) -> FileDigests:
    """Size, SHA-256 and expected entity tag of a file."""
    whole, pieces, size = hashlib.sha256(), [], 0
    with path.open("rb") as file:
        while piece := file.read(_CHUNK_BYTES):
            whole.update(piece)
            pieces.append(hashlib.md5(piece, usedforsecurity=False))
            size += len(piece)
    if len(pieces) == 1:
        return FileDigests(size, whole.hexdigest(), f'"{pieces[0].hexdigest()}"')
    joined = hashlib.md5(b"".join(each.digest() for each in pieces), usedforsecurity=False)
    return FileDigests(size, whole.hexdigest(), f'"{joined.hexdigest()}-{len(pieces)}"')


def _plain(error: Exception) -> str:
    """What went wrong, without the server's answer: that may repeat the key of an account or what was signed."""
    text = str(error)
    status, code = _STATUS.search(text), _CODE.search(text)
    if status is not None:
        return f"the server answers {status[1]}" + ("" if code is None else f" {code[1]}")
    for pattern, what in _FAULTS:
        if pattern.search(text) is not None:
            return what
    return f"the line failed ({type(error).__name__})"
