"""What makes a folder a store: made whole or not at all, and never locked out for the sake of one small file."""

import json
import multiprocessing
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from storage.check.recover import recover
from storage.check.verify import verify
from storage.store import Store, WriterLock
from stream.errors import StoreError
from tests.storage.conftest import START_NS, Filler

SYNC = os.fsync


class Killed(BaseException):
    """The process ends here."""


@pytest.mark.parametrize("error", [Killed(), OSError(28, "No space left on device")])
def test_the_making_of_a_store_can_be_cut_short_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    for at in range(20):
        folder = tmp_path / f"{at}"
        left = iter(range(at))

        def cut(_: object, call: Callable[..., Any], *arguments: object, steps: Any = left, **named: object) -> Any:
            if next(steps, None) is None:
                raise error
            return call(*arguments, **named)

        with monkeypatch.context() as patched:
            for owner, name in ((os, "fsync"), (Path, "mkdir"), (Path, "replace")):
                call = getattr(owner, name)
                patched.setattr(owner, name, lambda *given, call=call, **named: cut(None, call, *given, **named))
            try:
                Store.create(folder)
            except (Killed, StoreError):
                is_done = False
            else:
                is_done = True
        store = Store.create(folder)
        assert Store.open(folder).identity == store.identity
        assert (folder / "log" / "store.json").read_bytes() == (folder / "store.json").read_bytes()
        if is_done:
            break
    assert is_done
    assert at > 8


def test_what_a_full_disk_left_of_a_store_is_taken_up(tmp_path: Path) -> None:
    for part in ("log", "lake", "tmp"):
        (tmp_path / part).mkdir()
    (tmp_path / "tmp" / "store.json").write_bytes(b"")
    Store.create(tmp_path)
    assert [path.name for path in (tmp_path / "tmp").iterdir()] == []


@pytest.mark.parametrize("other", ["thesis.txt", "log/thesis.txt", "tmp/thesis.txt", "lake/00000001/part.json"])
def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path, other: str) -> None:
    (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / other).write_text("x")
    with pytest.raises(StoreError, match="holds other files"):
        Store.create(tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / other]


def _identity(folder: Path) -> str:
    return Store.create(folder).identity


@pytest.mark.long
def test_processes_that_make_one_store_have_one(tmp_path: Path) -> None:
    with multiprocessing.get_context("forkserver").Pool(4) as pool:
        for trial in range(5):
            assert len(set(pool.map(_identity, [tmp_path / f"{trial}"] * 4, chunksize=1))) == 1


@pytest.fixture
def filled(filler: Filler) -> Store:
    filler.counts("rate", START_NS, 100)
    filler.seal()
    filler.build()
    filler.release()
    return filler.store


def test_every_byte_of_the_marker_is_checked(filled: Store) -> None:
    marker = filled.folder / "store.json"
    content = marker.read_bytes()
    rng = random.Random(1)
    for at in range(len(content) - 1):
        damaged = bytearray(content)
        damaged[at] ^= 1 << rng.randrange(8)
        marker.write_bytes(damaged)
        with pytest.raises(StoreError, match="gyrofleet recover"):
            Store.open(filled.folder)
    marker.write_bytes(content)
    assert Store.open(filled.folder).identity == filled.identity


@pytest.mark.long
@pytest.mark.parametrize(
    "content", [None, b"", b"{}", b"[]", b"7", b"\xff", b'{"format": 1, "id": "x", "created_ns": 0}']
)
def test_a_marker_that_is_lost_or_damaged_is_made_anew(filled: Store, content: bytes | None) -> None:
    folder = filled.folder
    marker = folder / "store.json"
    marker.unlink() if content is None else marker.write_bytes(content)
    for opened in (Store.open, Store.create):
        with pytest.raises(StoreError, match=rf"log is there: `gyrofleet recover --store {folder}` rebuilds it"):
            opened(folder)
    store, reported = Store.open_or_repair(folder)
    assert (store.identity, reported is None) == (filled.identity, False)
    assert [path.read_bytes() for path in store.aside.iterdir()] == ([] if content is None else [content])
    assert Store.open_or_repair(folder)[1] is None
    assert verify(Store.open(folder))[0].is_sound


def test_without_a_copy_the_segments_say_whose_they_are(filled: Store) -> None:
    folder = filled.folder
    (folder / "store.json").unlink()
    (folder / "log" / "store.json").unlink()
    store, _ = Store.open_or_repair(folder)
    assert store.identity == filled.identity
    assert list(recover(store)) == []


def test_where_nothing_says_it_the_store_gets_another_identity(filled: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = filled.folder
    (folder / "store.json").unlink()
    (folder / "log" / "store.json").unlink()
    # as of segments that an older gyrofleet wrote
    monkeypatch.setattr("storage.store.identity_of_segments", lambda _folder: None)
    with WriterLock(filled, "test"), pytest.raises(StoreError, match="a process writes"):
        Store.open_or_repair(folder)
    store, reported = Store.open_or_repair(folder)
    assert store.identity != filled.identity
    assert f"it is now {store.identity}" in str(reported)
    assert verify(Store.open(folder))[0].samples == 100


@pytest.mark.long
def test_recover_makes_the_marker_anew(filled: Store, gyrofleet: Callable[..., Any]) -> None:
    (filled.folder / "store.json").write_bytes(b"x")
    assert "gyrofleet recover" in gyrofleet("verify", "--store", filled.folder, "--json").json["error"]["message"]
    done = gyrofleet("recover", "--store", filled.folder, "--json")
    assert (done.code, [each["what"] for each in done.json["actions"]]) == (0, ["store_marked"])
    assert gyrofleet("verify", "--store", filled.folder).code == 0


def test_a_store_from_before_checksums_opens_and_gets_its_copy(tmp_path: Path) -> None:
    identity = np.random.default_rng(1).bytes(16).hex()
    (tmp_path / "log").mkdir()
    (tmp_path / "store.json").write_text(json.dumps({"format": 1, "id": identity, "created_ns": 0}) + "\n")
    assert Store.open(tmp_path).identity == identity
    assert Store.create(tmp_path).identity == identity
    (tmp_path / "store.json").unlink()
    assert Store.open_or_repair(tmp_path)[0].identity == identity
