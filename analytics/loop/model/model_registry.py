"""Versions of the units' error models in a store: written once, never changed, and checked at each reading."""

import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import msgspec

from analytics.loop.model.error_model import ErrorModel, ModelNoise
from storage.sql.catalog import Catalog
from storage.store import Store, only_one
from stream.decoding import decode_json
from stream.errors import BadInput, NotFound, StoreError
from stream.files.atomic_file import sync_folder, write_durably
from stream.identity import check_name

FOLDER = "models"
_HASH_DIGITS = 32
_NAME = re.compile(r"(?P<version>\d{4,})-(?P<hash>[0-9a-f]{32})\.json")


class ModelVersion(msgspec.Struct, frozen=True, kw_only=True):
    """A version of the error model of a unit's signal, with the data that it is based on."""

    unit: str
    signal: str
    version: int  # from 1 on, for each unit
    parent: str | None  # hash of the version in use when this one was made
    text: str
    model: ErrorModel
    before: ErrorModel  # the model that it replaces, fitted to the same runs
    noise: ModelNoise  # left beside `model`
    block_s: float
    longest_s: float  # length of the longest run that it was fitted to
    runs: dict[str, str]  # that it was fitted to or confirmed by, with a hash of their stored data
    training_runs: tuple[str, ...]  # those that it was fitted to
    verdict: str  # of the trace that it comes from
    added: tuple[str, ...]  # effects that the declared model lacked
    holdout: dict[str, Any] | None  # result of the held-out runs
    made_ns: int
    by: str
    note: str = ""
    confounded: tuple[str, ...] = ()  # effects that explain the training runs as well
    error: dict[str, Any] | None = None  # with the declared model and with this one, as in the JSON of the diagnosis

    @property
    def is_confirmed(self) -> bool:
        """Whether the held-out runs have confirmed everything that was added."""
        return not self.added or bool(self.holdout and self.holdout.get("accepted"))

    def content(self) -> bytes:
        """Content of its file."""
        fields: dict[str, Any] = msgspec.to_builtins(self)
        for name in ("confounded", "error"):
            if not fields[name]:
                del fields[name]  # versions without it keep their hash
        return msgspec.json.format(msgspec.json.encode(fields, order="sorted"), indent=1) + b"\n"

    @property
    def hash(self) -> str:
        """Hash of its content; part of its file name."""
        return hash_of(self.content())


def no_version(unit: str) -> str:
    """Message that a unit has no version, and how to make the first one."""
    return (
        f"unit {unit} has no version of its error model: `gyrofleet model promote --unit {unit} --model 'rate = bias + "
        "temperature'`, with the terms that you declare, traces the unit's runs and writes version 1"
    )


def hash_of(content: bytes) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(content).hexdigest()[:_HASH_DIGITS]


class ModelRegistry:
    """The versions in a store: one file each, ``models/UNIT/NNNN-HASH.json``."""

    def __init__(self, store: Store) -> None:
        self._folder = store.folder / FOLDER

    @classmethod
    def of(cls, folder: Path) -> Self:
        """Return the registry of the store in a folder."""
        return cls(Store.open(folder))

    def units(self) -> list[str]:
        """Units that have a version."""
        if not self._folder.is_dir():
            return []
        return sorted(each.name for each in self._folder.iterdir() if each.is_dir() and any(_files(each)))

    def versions(self, unit: str) -> list[ModelVersion]:
        """All versions of a unit by increasing number; StoreError if one is damaged."""
        return [self._read(path) for path in self._paths(unit)]

    def readable(self, unit: str) -> tuple[list[ModelVersion], dict[int, str]]:
        """Versions of a unit by increasing number, and the errors of damaged ones by number."""
        found: list[ModelVersion] = []
        damaged: dict[int, str] = {}
        for path in self._paths(unit):
            try:
                found.append(self._read(path))
            except StoreError as error:
                damaged[_number(path)] = str(error)
        return found, damaged

    def version(self, unit: str, number: int) -> ModelVersion:
        """Return a version by its number; raises NotFound if there is none, StoreError if it is damaged."""
        paths = {_number(path): path for path in self._paths(unit)}
        if number not in paths:
            if not paths:
                raise NotFound(no_version(unit))
            raise NotFound(
                f"unit {unit} has no version {number} of its error model; there are {', '.join(map(str, paths))}"
            )
        return self._read(paths[number])

    def by_hash(self, unit: str, wanted: str) -> ModelVersion:
        """Return a version by its hash; raises as `version` does."""
        for path in self._paths(unit):
            if path.name.endswith(f"-{wanted}.json"):
                return self._read(path)
        raise NotFound(
            f"unit {unit}: version {wanted} of its error model is not in {self._folder / unit}; bring the file back "
            "from a copy of the store, or take the model out of use with `gyrofleet model rollback`"
        )

    def add(self, version: ModelVersion) -> ModelVersion:
        """Write a version under the next number of its unit and return it as written; it is then on disk.

        StoreError if it cannot be written, or another process is writing one.
        """
        folder = self._folder / check_name("unit", version.unit)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            sync_folder(self._folder.parent)
            sync_folder(self._folder)
            with only_one(self._folder / f"{version.unit}.lock", "gyrofleet model promote"):
                number = max((_number(path) for path in _files(folder)), default=0) + 1
                written = msgspec.structs.replace(version, version=number)
                path = folder / f"{number:04d}-{written.hash}.json"
                fresh = path.with_name(f".{path.name}.{os.getpid()}.part")  # it appears whole, or not at all
                write_durably(path, written.content(), fresh=fresh, overwrite=False)
        except OSError as error:
            raise StoreError(f"unit {version.unit}: its error model cannot be written to {folder}: {error}") from error
        return written

    def _paths(self, unit: str) -> list[Path]:
        return _files(self._folder / check_name("unit", unit))

    @staticmethod
    def _read(path: Path) -> ModelVersion:
        advice = "bring the file back from a copy of the store, or roll back to another version"
        try:
            content = path.read_bytes()
        except OSError as error:
            raise StoreError(f"error model {path} cannot be read ({error}); {advice}") from error
        match = _NAME.fullmatch(path.name)
        if match is None or hash_of(content) != match["hash"]:
            raise StoreError(
                f"error model {path} is not as it was written: its content does not match its hash; {advice}"
            )
        try:
            found = decode_json(content, ModelVersion)
            found.model.labels()
            found.before.labels()
        except (msgspec.MsgspecError, BadInput) as error:
            what = str(error).partition(";")[0]
            raise StoreError(
                f"error model {path} is not one of this gyrofleet ({what}); it is of a later version, or an own file "
                "that this installation lacks (GYROFLEET_OWN)"
            ) from error
        if found.unit != path.parent.name or found.version != _number(path):
            raise StoreError(
                f"error model {path} is version {found.version} of unit {found.unit}: it was copied to the wrong "
                "place; remove it"
            )
        return found


def run_hashes(catalog: Catalog, runs: Mapping[str, object] | tuple[str, ...]) -> dict[str, str]:
    """Hash of the stored data of each run: every recorded signal with its samples, times and meaning.

    Without signals that gyrofleet makes itself, such as ``rate_compensated``.
    """
    names = {name.partition("#")[0] for name in runs}
    rows = catalog.rows(
        """
        select run, sha256(string_agg(concat_ws('|', unit, signal, epoch, unit_of_measure, scale, "offset", samples,
            seq_first, seq_next, t_first_ns, t_last_ns), ';' order by unit, signal, epoch, channel)) as print
        from internal.lake_channels where not ends_with(signal, '_compensated') group by run order by run
        """
    )
    return {str(run): str(mark)[:_HASH_DIGITS] for run, mark in rows if run in names}


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if _NAME.fullmatch(path.name)), key=_number)


def _number(path: Path) -> int:
    return int(path.name.partition("-")[0])
