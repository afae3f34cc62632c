"""A part of the lake: a folder of Parquet files made from one or more sealed segments, described in its ``part.json``.

The description is written before the folder gets its name, and carries a hash of its content.
"""

import hashlib
import re
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import write_durably

PART = "part.json"
REMEDY = "`gyrofleet recover` rebuilds it from the parts and the log; no sample is lost"

_HEAD = b'{"sha256":"'
_MIDDLE = b'","content":'
_TAIL = b"}\n"
# of a folder or file in the lake, or of a segment; no file system has names above 255 bytes
_NAME = re.compile(r"\w[\w.-]{0,254}")
_NAMES = re.compile(r"\w[\w.-]{0,254}(?:\n\w[\w.-]{0,254})*")


class PartFile(msgspec.Struct, frozen=True, omit_defaults=True):
    """A file of a part; `footer` is a digest of its footer, empty in parts of an older gyrofleet."""

    bytes: int
    rows: int
    sha256: str
    footer: str = ""


class DroppedRows(msgspec.Struct, frozen=True):
    """Raw rows that a part no longer holds, and the document of it."""

    document: str
    samples: int
    bytes: int


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """A part of the lake: the folder `name`, made from the sealed `segments`, in order.

    `samples` are those in its segments, `sources` their SHA-256 (empty in parts of an older gyrofleet, and in a large
    manifest that was read without them). `dropped` is set once its raw rows are. `quarantined` messages cannot be
    built; the log keeps them and their samples. `columns` is the version of the columns of its files.
    """

    name: str
    segments: tuple[str, ...]
    files: dict[str, PartFile]
    samples: int
    t_first_ns: int | None = None
    t_last_ns: int | None = None
    arrival_first_ns: int | None = None
    arrival_last_ns: int | None = None
    dropped: DroppedRows | None = None
    sources: dict[str, str] = {}
    quarantined: int = 0
    quarantined_samples: int = 0
    columns: int = 1

    @property
    def bytes(self) -> int:
        """Size of its files."""
        return sum(file.bytes for file in self.files.values())

    @property
    def day(self) -> str:
        """UTC day of its first arrival; empty for an empty part."""
        if self.arrival_first_ns is None:
            return ""
        return datetime.fromtimestamp(self.arrival_first_ns // 10**9, UTC).strftime("%Y-%m-%d")


def hull(parts: Iterable[Part], name: str, files: dict[str, PartFile]) -> Part:
    """The description of a part that holds what `parts`, whose columns have one version, hold."""
    parts = list(parts)

    def known(field: str) -> list[int]:
        return [value for part in parts if (value := getattr(part, field)) is not None]

    dropped = [part.dropped for part in parts if part.dropped is not None]
    return Part(
        name=name,
        segments=tuple(sorted(segment for part in parts for segment in part.segments)),
        files=files,
        samples=sum(part.samples for part in parts),
        sources={segment: sha256 for part in parts for segment, sha256 in sorted(part.sources.items())},
        t_first_ns=min(known("t_first_ns"), default=None),
        t_last_ns=max(known("t_last_ns"), default=None),
        arrival_first_ns=min(known("arrival_first_ns"), default=None),
        arrival_last_ns=max(known("arrival_last_ns"), default=None),
        dropped=None
        if not dropped
        else DroppedRows(dropped[-1].document, sum(d.samples for d in dropped), sum(d.bytes for d in dropped)),
        quarantined=sum(part.quarantined for part in parts),
        quarantined_samples=sum(part.quarantined_samples for part in parts),
        columns=parts[0].columns,
    )


def read_part(folder: Path) -> Part:
    """The description in a part's folder."""
    path = folder / PART
    try:
        return decoded_part(path.read_bytes())
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} is damaged ({error}); {REMEDY}") from error


def write_part(folder: Path, part: Part) -> None:
    """Write a part's description into its folder."""
    write_sealed(folder / PART, part)


def with_sources(lake: Path, part: Part) -> Part:
    """A part with the SHA-256 of its segments, from its own description if it was read without them."""
    if part.sources or not part.segments:
        return part
    return msgspec.structs.replace(part, sources=read_part(lake / part.name).sources)


def in_order(parts: Iterable[Part]) -> list[Part]:
    """Parts in the order of their first segments."""
    return sorted(parts, key=lambda part: (part.segments[0], part.name))


def check_names(part: Part) -> None:
    """Refuse, by a ValueError, names that lead out of the lake."""
    if _NAMES.fullmatch("\n".join((part.name, *part.segments, *part.files))) is None:
        raise ValueError(f"a name of part {part.name!r:.80} is not a path within the lake")
    if not part.segments:
        raise ValueError(f"part {part.name!r} is of no segment")


def check_within(names: list[str]) -> None:
    """Refuse, by a ValueError, paths that lead out of the lake: folders and files are removed by these names."""
    if len(names) > 2 or any(_NAME.fullmatch(name) is None for name in names):
        raise ValueError(f"{'/'.join(names)!r:.80} is not a path within the lake")


def sealed(value: msgspec.Struct) -> bytes:
    """The content of a description's file, with its hash."""
    content = msgspec.json.encode(value)
    return _HEAD + hashlib.sha256(content).hexdigest().encode() + _MIDDLE + content + _TAIL


def unsealed(content: bytes) -> bytes:
    """What was sealed; ValueError if it does not match its hash."""
    begin = len(_HEAD) + 64
    inner = content[begin + len(_MIDDLE) : -len(_TAIL)]
    digest = hashlib.sha256(inner).hexdigest().encode()
    if content != _HEAD + digest + _MIDDLE + inner + _TAIL:
        raise ValueError("its content does not match its hash")
    return inner


def write_sealed(path: Path, value: msgspec.Struct) -> None:
    """Write a description's file, durably and as a whole."""
    write_durably(path, sealed(value), fresh=path.with_name(f"{path.name}.{time.time_ns()}.new"))


def decoded_part(content: bytes) -> Part:
    """The part that the content of a ``part.json`` describes; ValueError if that is damaged."""
    try:
        part = decode_json(unsealed(content), Part)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    check_names(part)
    return part
