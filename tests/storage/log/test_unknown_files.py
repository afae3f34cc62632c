"""What is not the store's own is passed over, reported and quarantined; manifests stay inside of the lake."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import msgspec
import numpy as np
import pytest

from storage.check.recover import recover
from storage.check.verify import verify
from storage.lake.builder import build_missing, builder_lock
from storage.lake.lake import Lake
from storage.log.event_log import EventLog
from storage.log.files import sealed_segments, unknown_files
from storage.manifests.lake import MANIFEST, LakeManifestDamaged, Replaced, read_manifest
from storage.manifests.log import manifest_path, read_log_manifest
from storage.recording.recorder import Recorder
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.identity import Place, sample_key
from stream.transport.bus import LocalBus

KEY = sample_key(Place("plant", "bench"), "U1", "rate")


def made(folder: Path, first: int, segments: int = 2) -> Store:
    """A store of segments with 100 samples each, numbered from `first`."""
    store = Store.create(folder)
    for i in range(segments):
        bus = LocalBus()
        with Recorder(store, bus, EventLog(store), sync_interval_s=0.001), DurablePublisher(bus) as publisher:
            seq = 100 * i
            counts = np.arange(100, dtype=np.int32)
            publisher.send_batch(
                KEY, SampleBatch("U1", "rate", "r1", UUID(int=first), seq, seq * 10**6, 10**6, "deg/s", counts=counts)
            )
            publisher.drain()
    return store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return made(tmp_path / "store", 1)


@pytest.fixture
def foreign(tmp_path: Path) -> Store:
    return made(tmp_path / "other", 2, segments=4)


def rows(store: Store) -> int:
    with Catalog(store) as catalog:
        return int(catalog.rows("select count(*) from samples")[0][0])


def put_in(store: Store, foreign: Store) -> list[str]:
    """All that somebody has put into a log by hand."""
    log = store.log
    shutil.copy(log / "00000001.mcap", log / "00000001 (copy).mcap")
    shutil.copy(log / "00000001.mcap", log / "00000009.mcap")
    shutil.copy(foreign.log / "00000003.mcap", log)
    shutil.copy(foreign.log / "00000004.mcap", log / "00000004.mcap.open")
    (log / "x.mcap").mkdir()
    (log / "00000008.mcap").mkdir()
    (log / "notes.txt").write_text("night shift")
    return ["00000001 (copy).mcap", "00000003.mcap", "00000004.mcap.open", "00000008.mcap", "00000009.mcap",
            "notes.txt", "x.mcap"]  # fmt: skip


def test_what_is_put_into_a_log_is_neither_built_nor_adopted(
    store: Store, foreign: Store, gyrofleet: Callable[..., Any]
) -> None:
    names = put_in(store, foreign)
    assert [path.name for path in sealed_segments(store)] == ["00000001.mcap", "00000002.mcap"]
    found, _ = verify(store)
    assert found.is_sound
    assert found.samples == 200
    reported = {Path(each.where).name: each.what for each in found.findings if each.kind == "file_unknown"}
    assert sorted(reported) == names
    assert foreign.identity in reported["00000003.mcap"]
    assert "copy of segment 00000001" in reported["00000009.mcap"]
    with builder_lock(store):
        assert list(build_missing(store)) == []
    log = EventLog(store)  # as every recorder begins
    log.seal()
    assert any("00000003.mcap" in warning for warning in log.warnings)
    assert rows(store) == 200
    assert list(recover(store)) == []
    assert gyrofleet("rebuild", "--store", store.folder).code == 0
    assert rows(store) == 200


@pytest.mark.long
def test_recover_moves_it_aside_when_asked(store: Store, foreign: Store, gyrofleet: Callable[..., Any]) -> None:
    names = put_in(store, foreign)
    done = gyrofleet("recover", "--quarantine", "--store", store.folder, "--json")
    assert done.code == 0
    assert [action["what"] for action in done.json["actions"]] == ["file_quarantined"] * len(names)
    assert unknown_files(store) == []
    aside = sorted(path.name.partition(".unknown-")[0] for path in store.aside.iterdir())
    assert aside == names
    assert made(store.folder, 3, segments=1).identity == store.identity
    assert rows(store) == 300


@pytest.mark.long
def test_segments_that_no_list_names_are_the_stores_by_what_they_say(store: Store, foreign: Store) -> None:
    """Sealed by a process that was killed before it could list them; or the list is lost, and the identity with it."""
    manifest_path(store).unlink()
    shutil.copy(foreign.log / "00000003.mcap", store.log)
    assert [path.name for path in sealed_segments(store)] == ["00000001.mcap", "00000002.mcap"]
    list(recover(store))
    assert sorted(read_log_manifest(store).entries) == ["00000001.mcap", "00000002.mcap"]
    (store.folder / "store.json").unlink()
    (store.log / "store.json").unlink()
    again, _ = Store.open_or_repair(store.folder)
    assert again.identity == store.identity


def test_a_damaged_head_does_not_make_a_segment_foreign(store: Store) -> None:
    segment = store.log / "00000002.mcap"
    content = bytearray(segment.read_bytes())
    at = content.index(store.identity.encode())
    content[at] ^= 1
    segment.write_bytes(content)
    manifest_path(store).unlink()
    assert unknown_files(store) == []


@pytest.mark.long
def test_a_part_of_another_lake_is_not_taken_in(store: Store, foreign: Store) -> None:
    shutil.copytree(foreign.lake / "00000003", store.lake / "00000003")
    with builder_lock(store):
        assert list(build_missing(store)) == []
    assert rows(store) == 200
    assert [path.name.partition(".")[0] for path in (store.folder / "lake-aside").iterdir()] == ["00000003"]
    (store.lake / MANIFEST).unlink()
    shutil.copytree(foreign.lake / "00000004", store.lake / "00000004")
    list(recover(store))
    assert rows(store) == 200


def sealed(content: bytes) -> bytes:
    return b'{"sha256":"' + hashlib.sha256(content).hexdigest().encode() + b'","content":' + content + b"}\n"


@pytest.mark.long
@pytest.mark.parametrize("path", ["../log", "..", "/etc", "00000001/../../log", "a/b/c", "", "00000001/.."])
def test_a_manifest_that_leads_out_of_the_lake_is_damaged(
    store: Store, path: str, gyrofleet: Callable[..., Any]
) -> None:
    """`lake --once` deleted the log, and said nothing."""
    manifest = read_manifest(store)
    gone = msgspec.structs.replace(manifest, replaced=(Replaced(path, 0),))
    (store.lake / MANIFEST).write_bytes(sealed(msgspec.json.encode(gone)))
    with pytest.raises(LakeManifestDamaged, match="not a path within the lake"), builder_lock(store):
        Lake(store).purge(0.0)
    assert len(sealed_segments(store)) == 2
    if path == "../log":
        done = gyrofleet("lake", "--once", "--store", store.folder)
        assert done.code == 1
        assert "not a path within the lake" in done.err
    list(recover(store))
    assert verify(store)[0].is_sound
    assert rows(store) == 200


def test_names_of_parts_and_files_stay_within_the_lake(store: Store) -> None:
    manifest = read_manifest(store)
    (part, *rest) = manifest.parts
    for changed in (
        msgspec.structs.replace(part, name="../lake-aside"),
        msgspec.structs.replace(part, segments=("../x",)),
        msgspec.structs.replace(part, files={"../../log/00000001.mcap": part.files["samples.parquet"]}),
    ):
        content = msgspec.json.encode(msgspec.structs.replace(manifest, parts=(changed, *rest)))
        (store.lake / MANIFEST).write_bytes(sealed(content))
        with pytest.raises(LakeManifestDamaged, match="not a path within the lake"):
            read_manifest(store)
