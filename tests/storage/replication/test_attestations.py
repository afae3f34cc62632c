"""A plant's attestations travel with its segments, and the fleet store compares what has arrived with them."""

from pathlib import Path

import msgspec
import pytest

from storage.attestation.attestation import attest, kept_attestations
from storage.attestation.comparison import own_findings
from storage.attestation.signing_key import SigningKey, create_key
from storage.check.verify_fleet import verify_fleet
from storage.fleet_store import FleetStore
from storage.manifests.log import read_log_manifest, rewrite_manifest
from storage.replication.arriving.attestation_check import KIND
from storage.replication.sources.folder_source import FolderSource
from storage.store import Store
from stream.errors import StoreError
from tests.storage.replication.plants import plant, received
from tests.storage.verified_store import fill


@pytest.fixture
def key(tmp_path: Path) -> SigningKey:
    create_key(tmp_path / "attest.pem")
    return SigningKey(tmp_path / "attest.pem")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A plant with a certificate."""
    store = plant(tmp_path / "a")
    (store.folder / "certificates").mkdir()
    (store.folder / "certificates" / "C-1.pdf").write_bytes(b"%PDF")
    return store


def test_attestations_arrive_and_agree_and_later_ones_follow(store: Store, key: SigningKey, tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    attest(store, key)
    with FolderSource(store.folder) as source:
        first = received(source, fleet)
        assert (first.added, first.added_files, first.is_well) == (4, 2, True)
        copy = fleet.replica("a").store
        assert [each.read_bytes() for each in kept_attestations(copy)] == [
            each.read_bytes() for each in kept_attestations(store)
        ]
        fill(store, range(8, 10))
        attest(store, key)
        second = received(source, fleet)
    assert (second.added, second.added_files, second.is_well, second.notes) == (1, 1, True, ())
    assert list(own_findings(copy)) == []
    with pytest.raises(StoreError, match="attest at the plant"):
        attest(copy, key)


def test_a_segment_that_arrives_later_than_its_followers_is_no_reordering(
    store: Store, key: SigningKey, tmp_path: Path
) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    attest(store, key)
    path = store.log / "00000002.mcap"
    path.rename(tmp_path / path.name)
    with FolderSource(store.folder) as source:
        assert [each.kind for each in received(source, fleet).refused] == ["segment_missing"]
        (tmp_path / path.name).rename(path)
        late = received(source, fleet)
        assert (late.added, late.is_well) == (1, True)
    copy = fleet.replica("a").store
    assert list(read_log_manifest(copy).entries)[-1] == path.name
    assert list(own_findings(copy)) == []
    with pytest.raises(StoreError, match="attest at the plant"):
        attest(copy, key)


def test_a_copy_that_is_behind_its_attestation_is_well(store: Store, key: SigningKey, tmp_path: Path) -> None:
    """The attestation names segments that have not arrived yet."""
    fleet = FleetStore.create(tmp_path / "fleet")
    with FolderSource(store.folder) as source:
        received(source, fleet)
    copy = fleet.replica("a").store
    fill(store, range(8, 12))
    path = attest(store, key).path
    (copy.folder / "attestations").mkdir()
    (copy.folder / "attestations" / path.name).write_bytes(path.read_bytes())
    assert list(own_findings(copy)) == []
    with pytest.raises(StoreError, match="attest at the plant"):
        attest(copy, key)


def test_a_file_that_was_changed_before_it_was_fetched_is_found_and_named(
    store: Store, key: SigningKey, tmp_path: Path
) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    attest(store, key)
    (store.folder / "certificates" / "C-1.pdf").write_bytes(b"%PDF changed")
    with FolderSource(store.folder) as source:
        for _ in range(2):  # it stays reported
            found = received(source, fleet)
            (refusal,) = found.refused
            assert (refusal.kind, refusal.segment) == (KIND, "C-1.pdf")
            assert "certificates/C-1.pdf is another file than was attested" in refusal.what
            assert not found.is_well
    kinds = {each.kind for each in verify_fleet(fleet).plants["a"].findings}
    assert "attested_changed" in kinds


def test_a_rewritten_history_does_not_agree_with_what_was_signed(store: Store, key: SigningKey, tmp_path: Path) -> None:
    """The plant's log is replaced with a validly chained one before the fleet store first sees it."""
    fleet = FleetStore.create(tmp_path / "fleet")
    attest(store, key)
    entries = {**read_log_manifest(store).entries}
    name = sorted(entries)[1]
    entries[name] = msgspec.structs.replace(entries[name], samples=entries[name].samples + 1)
    rewrite_manifest(store, entries.values())
    with FolderSource(store.folder) as source:
        found = received(source, fleet)
    assert [(each.kind, each.segment) for each in found.refused] == [(KIND, name)]
    assert "another one than was attested" in found.refused[0].what


def test_a_new_key_is_noted(store: Store, key: SigningKey, tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    attest(store, key)
    create_key(tmp_path / "other.pem")
    attest(store, SigningKey(tmp_path / "other.pem"))
    with FolderSource(store.folder) as source:
        found = received(source, fleet)
    assert found.is_well
    assert any("ask whose it is" in each for each in found.notes)


def test_a_forged_attestation_is_refused(store: Store, key: SigningKey, tmp_path: Path) -> None:
    fleet = FleetStore.create(tmp_path / "fleet")
    path = attest(store, key).path
    path.write_text(path.read_text().replace('\\"store\\":\\"', '\\"store\\":\\"x', 1))
    with FolderSource(store.folder) as source:
        found = received(source, fleet)
    assert [each.kind for each in found.refused] == [KIND]
    assert "its signature is not that of its key and text" in found.refused[0].what
