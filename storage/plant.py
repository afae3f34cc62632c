"""A plant's identity, by which a fleet store knows it: a name, and what no other plant has."""

import json
import re
import time
import unicodedata
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import msgspec

from storage.segments.disk import DISK
from storage.store_marker import is_replica
from stream.decoding import converted
from stream.errors import BadInput, StoreError
from stream.files.atomic_file import write_durably

FILE = "plant.json"
_NAME = re.compile(r"\w[\w.-]{0,63}")
_STORE = re.compile(r"[0-9a-f]{32}")
_SEGMENT = re.compile(r"\d{8}\.mcap")
_SHA256 = re.compile(r"[0-9a-f]{64}")


class Plant(msgspec.Struct, frozen=True):
    """Identity of a plant: its name, the random identity of its store, and its first segment with the SHA-256.

    >>> Plant("hangzhou", "5e" * 16, "00000001.mcap", "ab" * 32).name
    'hangzhou'
    """

    name: str
    store: str
    first_segment: str
    first_sha256: str

    @property
    def chain(self) -> tuple[str, str]:
        """What another plant of the same name does not have."""
        return self.store, self.first_sha256


def check_plant_name(name: str) -> str:
    """Return `name` if it can be a plant's: a folder of the fleet store has it.

    >>> check_plant_name("hangzhou-2"), check_plant_name("杭州")
    ('hangzhou-2', '杭州')
    """
    if _NAME.fullmatch(name) is None or unicodedata.normalize("NFC", name) != name:
        raise BadInput(
            f"{name[:80]!r} cannot be the name of a plant: 1 to 64 letters, digits, '_', '-' or '.', and no '.' or '-' "
            "first, as hangzhou-2; give one with --plant"
        )
    return name


def checked(plant: Plant) -> Plant:
    """Return a plant's identity as another machine states it, if it is one; else BadInput."""
    check_plant_name(plant.name)
    parts = ((_STORE, plant.store), (_SEGMENT, plant.first_segment), (_SHA256, plant.first_sha256))
    if any(pattern.fullmatch(text) is None for pattern, text in parts):
        raise BadInput(f"plant {plant.name}: its identity is not one: {str(plant)[:300]}")
    return plant


def read_plant(folder: Path) -> Plant | None:
    """The identity in a store's folder; None if it has none yet; StoreError if it is damaged."""
    path = folder / FILE
    try:
        written = json.loads(path.read_text(encoding="utf-8"))
        mark = written.pop("sha256")
        if mark != _checksum(written):
            raise ValueError("its checksum does not match")
        return checked(converted(written["plant"], Plant))
    except FileNotFoundError:
        return None
    except (
        OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, msgspec.ValidationError, BadInput,
    ) as error:  # fmt: skip
        raise StoreError(
            f"{path} is damaged ({error}); restore it from a copy, or delete it and name the plant again by --plant"
        ) from error


def write_plant(folder: Path, plant: Plant) -> None:
    """Write a plant's identity into its store's folder, once and durably."""
    content = {"plant": msgspec.to_builtins(plant), "created_ns": time.time_ns()}
    line = json.dumps(content | {"sha256": _checksum(content)}, ensure_ascii=False) + "\n"
    write_durably(folder / FILE, line.encode(), fresh=folder / "tmp" / FILE)


def plant_of(folder: Path, store: str, first: tuple[str, str], name: str | None) -> Plant:
    """The identity of the plant whose store has that identity and that first segment; created at its first use.

    `name` is by default the folder's. Where the folder cannot be written the identity is not kept.
    """
    known = read_plant(folder)
    if known is not None:
        if name not in (None, known.name) and not is_replica(folder):
            raise BadInput(f"{folder} is the store of plant {known.name}; a plant keeps its name")
        if known.store != store:
            raise StoreError(
                f"{folder} is the store {store}, and its {FILE} is of plant {known.name} with the store {known.store}; "
                "restore the right one from a copy"
            )
        return known
    plant = checked(Plant(check_plant_name(name or folder.resolve().name), store, *first))
    with suppress(OSError):
        (folder / "tmp").mkdir(exist_ok=True)
        write_plant(folder, plant)
        DISK.sync_folder(folder)
    return plant


def _checksum(content: dict[str, object]) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
