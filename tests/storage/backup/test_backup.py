"""Backups of a store: what is in them, what is added, what is damaged, and what is refused."""

import errno
import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrofleet import main
from storage.backup import restore as restoring
from storage.backup.backup import back_up, read_backup
from storage.backup.restore import restore
from storage.check.recover import Action, recover
from storage.check.verify import verify
from storage.fleet_store import FleetStore
from storage.lake.builder import build_missing
from storage.log.event_log import EventLog
from storage.recording.disk_watch import format_bytes
from storage.recording.recorder import Recorder
from storage.segments.disk import DISK, Space
from storage.sql.door import SqlDoor
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput, StoreError
from stream.transport.bus import LocalBus
from tests.storage.verified_store import KEY, batch, damage_last_chunk, fill, filled

COUNTS = "select unit, count(*) as n, sum(counts) as total from samples group by unit order by unit"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store of three segments that are in the lake, with files that no segment has."""
    return filled(tmp_path / "S", range(2), range(2, 4), range(4, 6), then=complete)


def complete(store: Store) -> None:
    list(build_missing(store))
    (store.folder / "certificates").mkdir()
    (store.folder / "certificates" / "C-1.pdf").write_bytes(b"%PDF")
    (store.folder / "seal.key").write_bytes(os.urandom(32))
    (store.folder / "seal.key").chmod(0o600)
    (store.folder / "alerts").mkdir()
    with closing(sqlite3.connect(store.folder / "alerts" / "alerts.db")) as database:
        database.execute("create table alert (text)")
        database.execute("insert into alert values ('chamber off its set-point')")
        database.commit()


def counts(store: Store) -> list[dict[str, Any]]:
    with SqlDoor(store) as door:
        rows: list[dict[str, Any]] = door.ask(COUNTS).read_all().to_pylist()
        return rows


def test_a_backup_is_no_store(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")
    for opened in (Store.open, Store.open_or_repair):
        with pytest.raises(StoreError, match=r"B is a backup, not a store: `gyrofleet restore"):
            opened(tmp_path / "B")
    with pytest.raises(BadInput, match="lies within the backup"):
        restore(tmp_path / "B", tmp_path / "B" / "x")


def test_a_restored_store_is_the_same(store: Store, tmp_path: Path) -> None:
    done = back_up(store, tmp_path / "B")
    assert (done.added_segments, len(done.backup.segments)) == (3, 3)
    restore(tmp_path / "B", tmp_path / "R")
    new = Store.open(tmp_path / "R")
    assert new.identity == store.identity
    assert verify(new)[0].is_sound
    assert counts(new) == counts(store)
    for path in [*sorted(store.log.glob("*.mcap")), store.log / "manifest.jsonl"]:
        assert (new.log / path.name).read_bytes() == path.read_bytes()
    for name in ("seal.key", "certificates/C-1.pdf"):
        assert (new.folder / name).read_bytes() == (store.folder / name).read_bytes()
    assert (new.folder / "seal.key").stat().st_mode & 0o777 == 0o600
    with closing(sqlite3.connect(new.folder / "alerts" / "alerts.db")) as database:
        assert database.execute("select * from alert").fetchall() == [("chamber off its set-point",)]
    fill(new, range(6, 8))  # it can be written on
    assert verify(new)[0].is_sound


def test_a_backup_is_a_folder_beside_its_store(store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An address on an object store would become a folder here, and a backup in its store hold itself."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="a backup there would hold itself"):
        back_up(store, store.folder / "backup")
    back_up(store, tmp_path / "B")
    address = Path("s3://gyros/a")
    for refused in (
        lambda: back_up(store, address), lambda: restore(tmp_path / "B", address), lambda: Store.create(address),
        lambda: FleetStore.create(Path("S3:/gyros/a")),
    ):  # fmt: skip
        with pytest.raises(BadInput, match="looks like an address on an object store"):
            refused()
    assert {path.name for path in tmp_path.iterdir()} == {"S", "B"}
    assert not (store.folder / "backup").exists()


@pytest.mark.long
def test_the_next_backup_adds_what_is_new(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")
    again = back_up(store, tmp_path / "B")
    assert (again.added_segments, again.added_bytes) == (0, 0)
    fill(store, range(6, 8))
    (store.folder / "certificates" / "C-1.pdf").write_bytes(b"%PDF 2")
    third = back_up(store, tmp_path / "B")
    assert (third.added_segments, len(third.backup.segments)) == (1, 4)
    restore(tmp_path / "B", tmp_path / "R")
    assert (tmp_path / "R" / "certificates" / "C-1.pdf").read_bytes() == b"%PDF 2"
    assert counts(Store.open(tmp_path / "R")) == counts_after_build(store)


def counts_after_build(store: Store) -> list[dict[str, Any]]:
    list(build_missing(store))
    return counts(store)


@pytest.mark.long
def test_the_open_segment_is_in_it_once(store: Store, tmp_path: Path) -> None:
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.001), DurablePublisher(bus) as publisher:
        for number in (6, 7):
            publisher.send_batch(KEY, batch(number))
            publisher.drain()
            done = back_up(store, tmp_path / "B")
    assert [Path(each.path).name for each in done.backup.open] == ["00000004.mcap.open"]
    assert len(list((tmp_path / "B" / "open").glob("*/*"))) == 1
    restore(tmp_path / "B", tmp_path / "R")
    assert counts(Store.open(tmp_path / "R")) == counts_after_build(store)


@pytest.mark.long
def test_damage_in_the_backup_is_found_and_copied_again(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")
    damaged = tmp_path / "B" / "log" / "00000002.mcap"
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    with pytest.raises(StoreError, match=r"00000002\.mcap is damaged"):
        restore(tmp_path / "B", tmp_path / "R")
    with pytest.raises(StoreError, match="is not a gyrofleet store"):
        Store.open(tmp_path / "R")
    assert back_up(store, tmp_path / "B", is_checked=True).rewritten == ("00000002.mcap",)
    restore(tmp_path / "B", tmp_path / "R")
    assert counts(Store.open(tmp_path / "R")) == counts(store)


def test_a_damaged_store_leaves_the_backup_as_it_was(store: Store, tmp_path: Path) -> None:
    before = back_up(store, tmp_path / "B").backup
    fill(store, range(6, 8))
    sealed = store.log / "00000004.mcap"
    content = bytearray(sealed.read_bytes())
    content[len(content) // 2] ^= 1
    sealed.write_bytes(content)
    with pytest.raises(StoreError, match="is not as it was sealed"):
        back_up(store, tmp_path / "B")
    assert read_backup(tmp_path / "B") == before
    restore(tmp_path / "B", tmp_path / "R")
    assert verify(Store.open(tmp_path / "R"))[0].is_sound


def test_damage_in_the_store_after_a_backup_is_named(
    store: Store, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    before = back_up(store, tmp_path / "B").backup
    flipped, cut = store.log / "00000001.mcap", store.log / "00000002.mcap"
    content = bytearray(flipped.read_bytes())
    content[len(content) // 2] ^= 1
    flipped.write_bytes(content)
    cut.write_bytes(cut.read_bytes()[:-1])
    # without a check what was copied before is not read again
    done = gyrofleet("backup", "B", "--store", "S", "--json")
    assert (done.code, done.json["damaged"]) == (1, ["00000002.mcap"])
    checked = gyrofleet("backup", "B", "--check", "--store", "S")
    assert checked.code == 1
    assert "00000001.mcap is damaged; it is whole in the backup" in checked.err
    assert "`gyrofleet restore B --store NEW`" in checked.err  # a store that is there is no place to restore into
    assert read_backup(tmp_path / "B").segments == before.segments
    assert restore(tmp_path / "B", tmp_path / "R")
    assert verify(Store.open(tmp_path / "R"))[0].is_sound
    into_new = gyrofleet("backup", "N", "--store", "S")
    assert (into_new.code, "N is no backup yet" in into_new.err) == (1, True)
    (tmp_path / "B" / "log" / flipped.name).write_bytes(bytes(content))
    assert "its copy of the segment damaged as well" in gyrofleet("backup", "B", "--check", "--store", "S").err
    flipped.unlink()
    assert "00000001.mcap is not there: `gyrofleet verify --store S`" in gyrofleet("backup", "M", "--store", "S").err


@pytest.mark.long
def test_what_the_store_has_lost_stays_in_the_backup(
    store: Store, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    back_up(store, tmp_path / "B")
    (store.log / "00000002.mcap").unlink()
    assert gyrofleet("recover", "--store", "S", "--json").code == 0
    done = back_up(store, tmp_path / "B")
    assert [entry.segment for entry in done.backup.lost] == ["00000002.mcap"]
    assert (tmp_path / "B" / "log" / "00000002.mcap").exists()


@pytest.mark.long
@pytest.mark.parametrize("path", ["log/../../x", "files/../../x", "files//etc/x", "files/.."])
def test_paths_out_of_the_folder_are_refused(store: Store, tmp_path: Path, path: str) -> None:
    back_up(store, tmp_path / "B")
    marker = tmp_path / "B" / "backup.json"
    content = json.loads(marker.read_text())
    content["files"][0]["path"] = path
    marker.write_text(json.dumps(content))
    with pytest.raises(StoreError, match="no path of a backup"):
        restore(tmp_path / "B", tmp_path / "R")
    assert not (tmp_path / "x").exists()


def test_folders_of_others_are_refused(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")
    other = Store.create(tmp_path / "O")
    with pytest.raises(StoreError, match="is a backup of the store"):
        back_up(other, tmp_path / "B")
    with pytest.raises(StoreError, match="holds other files and is no backup"):
        back_up(other, tmp_path / "S")
    with pytest.raises(StoreError, match="S is a store already, and nothing was restored into it"):
        restore(tmp_path / "B", tmp_path / "S")
    with pytest.raises(StoreError, match="S is a store and no backup"):
        restore(tmp_path / "S", tmp_path / "R")
    shutil.rmtree(tmp_path / "B" / "log")
    with pytest.raises(StoreError, match="is incomplete"):
        restore(tmp_path / "B", tmp_path / "R")


def test_a_refused_restoration_names_the_folder_that_is_wrong(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands that it proposes are not of the store that is to be made."""
    monkeypatch.chdir(tmp_path)
    back_up(store, Path("B"))
    for name in ("full", "empty"):
        Path(name).mkdir()
    Path("full/x").touch()
    shutil.copytree("B", "C")
    shutil.copytree("B", "Bad")
    Path("Bad/backup.json").write_text("{")
    proposed = "`gyrofleet backup FOLDER --store STORE` has written"
    for source, folder, expected in (
        ("B", "S", "S is a store already, and nothing was restored into it: give a new folder as --store"),
        ("B", "C", "C is itself a backup, and nothing was restored into it: give a new folder as --store"),
        ("B", "full", "full is not empty, and nothing was restored into it: give a new folder as --store"),
        ("B", "full/x", "full/x is a file: nothing can be restored into full/x; give a new folder as --store"),
        ("B", "B/in", "B/in lies within the backup B: give a new folder elsewhere as --store"),
        ("S", "N", "S is a store and no backup: `gyrofleet backup FOLDER --store S` writes one"),
        ("B/log", "N", f"B/log is no backup: it holds no backup.json; {tmp_path / 'B'} is one; give a folder that"),
        ("empty", "N", f"empty is no backup: it holds no backup.json; give a folder that {proposed}"),
        ("no", "N", f"the backup no is not there: give a folder that {proposed}"),
        ("Bad", "N", "Bad/backup.json cannot be read: "),
        ("s3://x/y", "N", "s3:/x/y looks like an address on an object store"),
    ):
        done = CliRunner().invoke(main, ["restore", source, "--store", folder])
        assert done.exit_code == 1
        assert expected in done.stderr
        assert not Path("N").exists()
    Path("B/log/00000001.mcap").unlink()
    done = CliRunner().invoke(main, ["restore", "B", "--store", "N"])
    assert "the backup B is incomplete: " in done.stderr


@pytest.mark.long
def test_an_interrupted_restoration_is_repeated(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")

    def interrupt(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        restore(tmp_path / "B", tmp_path / "R", interrupt)
    assert not (tmp_path / "R" / "store.json").exists()
    restore(tmp_path / "B", tmp_path / "R")
    assert counts(Store.open(tmp_path / "R")) == counts(store)


def test_an_empty_store_has_a_backup(tmp_path: Path) -> None:
    Store.create(tmp_path / "S")
    back_up(Store.open(tmp_path / "S"), tmp_path / "B")
    restore(tmp_path / "B", tmp_path / "R")
    assert verify(Store.open(tmp_path / "R"))[0].samples == 0


@pytest.mark.long
def test_two_restorations_into_one_folder_do_not_mix(store: Store, tmp_path: Path) -> None:
    """The second would take what the first has written so far for the rest of an interrupted one."""
    back_up(store, tmp_path / "B")
    refused = []

    def second(_share: float) -> None:
        with pytest.raises(StoreError, match="another `gyrofleet restore` is at work"):
            restore(tmp_path / "B", tmp_path / "R")
        refused.append(True)

    restore(tmp_path / "B", tmp_path / "R", second)
    assert refused
    assert verify(Store.open(tmp_path / "R"))[0].is_sound


@pytest.mark.long
def test_a_restoration_that_is_killed_while_it_builds_the_lake_is_repeated(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    back_up(store, tmp_path / "B")

    class Killed(BaseException):
        pass

    def die(_store: Store) -> list[Action]:
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr(restoring, "recover", die)
        with pytest.raises(Killed):
            restore(tmp_path / "B", tmp_path / "R")
    assert not verify(Store.open(tmp_path / "R"))[0].is_sound
    restore(tmp_path / "B", tmp_path / "R")
    assert verify(Store.open(tmp_path / "R"))[0].is_sound
    assert not (tmp_path / "R" / "restoring").exists()


def test_a_salvaged_part_never_replaces_the_whole_segment(store: Store, tmp_path: Path) -> None:
    back_up(store, tmp_path / "B")
    kept = {path.name: path.read_bytes() for path in (tmp_path / "B").rglob("*") if path.is_file()}
    damage_last_chunk(store.log / "00000002.mcap")
    assert [each for each in recover(store) if each.what == "segment_salvaged"]
    for is_checked in (False, True):
        with pytest.raises(StoreError, match=r"has segment 00000002\.mcap whole, 200 samples, the store has the part"):
            back_up(store, tmp_path / "B", is_checked=is_checked)
    assert {path.name: path.read_bytes() for path in (tmp_path / "B").rglob("*") if path.is_file()} == kept
    restored = tmp_path / "R"
    restore(tmp_path / "B", restored)
    assert verify(Store.open(restored))[0].samples == 600
    assert len(back_up(store, tmp_path / "B2").backup.segments) >= 3


@pytest.mark.parametrize("before", [False, True])
def test_a_full_disk_is_named_with_its_sizes(
    before: bool, store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "B"
    if before:
        back_up(store, folder)
        (folder / "log" / "00000002.mcap").unlink()
    else:
        folder.mkdir()
    names = ["00000002.mcap"] if before else [path.name for path in store.log.glob("*.mcap")]
    others = ["certificates/C-1.pdf", "seal.key", "alerts/alerts.db"]
    least = sum((store.log / name).stat().st_size for name in names)
    least += sum((store.folder / name).stat().st_size for name in others)

    def refuse(_file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("storage.backup.copied_file.os.fsync", refuse)
    monkeypatch.setattr(type(DISK), "space", lambda _disk, _folder: Space(1_200, 5_000))
    kept = "the one before is as it was" if before else "there is no backup yet"
    with pytest.raises(
        StoreError, match=r"the disk is full.* are still to be copied, 1\.2 kB are free; .*" + kept
    ) as found:
        back_up(store, folder)
    assert format_bytes(least) in str(found.value)
    assert list(folder.rglob("*.part")) == [], "what is half copied takes no room"


def test_a_link_to_nowhere_is_named(store: Store, tmp_path: Path) -> None:
    (tmp_path / "usb").symlink_to(tmp_path / "mnt/usb")
    for folder in (tmp_path / "usb", tmp_path / "usb/night"):
        with pytest.raises(BadInput, match=r"usb is a symbolic link to .*mnt/usb, and that is not there"):
            back_up(store, folder)


def test_a_backup_that_fails_changes_no_segment(store: Store, tmp_path: Path) -> None:
    """The copy of one segment is damaged in the backup, another one in the store."""
    back_up(store, tmp_path / "B")
    copy = tmp_path / "B" / "log" / "00000001.mcap"
    copy.write_bytes(copy.read_bytes()[:-1])
    damage_last_chunk(store.log / "00000001.mcap")
    before = copy.read_bytes()
    with pytest.raises(StoreError, match="the backup is as it was"):
        back_up(store, tmp_path / "B")
    assert copy.read_bytes() == before
