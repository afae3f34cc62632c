"""Whatever of a store's history is changed after an attestation is found and named."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from storage.attestation.attestation import Attestation, attest, read_attestation
from storage.attestation.comparison import against
from storage.attestation.signing_key import SigningKey, create_key, fingerprint
from storage.check.recover import recover
from storage.check.verify import verify
from storage.log.event_log import EventLog
from storage.manifests.log import manifest_path, read_log_manifest, rewrite_manifest
from storage.segments.disk import sha256_of
from storage.store import Store
from stream.errors import BadInput, StoreError
from tests.storage.verified_store import fill, filled

NAMES = [f"{number:08d}.mcap" for number in range(1, 5)]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Four segments, a certificate and an error model."""
    store = filled(tmp_path / "S", range(2), range(2, 4), range(4, 6), range(6, 8))
    for name in ("certificates/C-1.pdf", "models/U1/0001-0123456789abcdef.json"):
        (store.folder / name).parent.mkdir(parents=True)
        (store.folder / name).write_bytes(b"%PDF")
    return store


def what(store: Store, attestation: Attestation) -> list[tuple[str, str]]:
    """Kind and file of each finding of the comparison."""
    return [(each.kind, Path(each.where).name) for each in against(store, attestation, "kept.json")]


def rechain(store: Store, **changes: Any) -> None:
    """Write the manifest again, validly chained, as a forger who knows its form does."""
    entries = {**read_log_manifest(store).entries}
    for name, changed in changes.items():
        entries[f"{name[1:]}.mcap"] = msgspec.structs.replace(entries[f"{name[1:]}.mcap"], **changed)
    rewrite_manifest(store, entries.values())


def test_an_unchanged_store_agrees_and_so_does_what_comes_later(store: Store, key: SigningKey) -> None:
    kept = attest(store, key).attestation
    assert what(store, kept) == []
    fill(store, range(8, 10))
    rewrite_manifest(store, read_log_manifest(store).entries.values())  # as `gyrofleet recover` does
    (store.folder / "certificates" / "C-2.pdf").write_bytes(b"%PDF")
    assert what(store, kept) == []
    attest(store, key)
    assert verify(store)[0].is_sound or list(recover(store))
    assert what(store, kept) == []


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_replaced_segment_is_named_though_the_chain_is_whole(store: Store, key: SigningKey, name: str) -> None:
    kept = attest(store, key).attestation
    path = store.log / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    rechain(store, **{f"_{path.stem}": {"sha256": sha256_of(path)}})
    assert what(store, kept) == [("attested_changed", name)]


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_removed_segment_is_named_though_the_chain_is_whole(store: Store, key: SigningKey, name: str) -> None:
    kept = attest(store, key).attestation
    (store.log / name).unlink()
    entries = read_log_manifest(store).entries
    rewrite_manifest(store, [entry for each, entry in entries.items() if each != name])
    assert what(store, kept) == [("attested_missing", name)]


def test_a_changed_line_and_another_order_are_named(store: Store, key: SigningKey) -> None:
    kept = attest(store, key).attestation
    whole = manifest_path(store).read_bytes()
    rechain(store, _00000003={"samples": 7})
    assert what(store, kept) == [("attested_changed", NAMES[2])]
    manifest_path(store).write_bytes(whole)
    entries = list(read_log_manifest(store).entries.values())
    rewrite_manifest(store, [entries[0], entries[2], entries[1], entries[3]])
    assert what(store, kept) == [("attested_changed", NAMES[2])]


def test_a_segment_put_in_before_the_anchor_is_named(store: Store, key: SigningKey) -> None:
    entries = list(read_log_manifest(store).entries.values())
    rewrite_manifest(store, [entries[0], entries[2], entries[3]])
    kept = attest(store, key).attestation
    rewrite_manifest(store, entries)
    assert what(store, kept) == [("attested_changed", NAMES[1])]


@pytest.mark.long
@pytest.mark.parametrize("name", ["certificates/C-1.pdf", "models/U1/0001-0123456789abcdef.json"])
def test_changed_and_removed_files_are_named(store: Store, key: SigningKey, name: str) -> None:
    kept = attest(store, key).attestation
    path = store.folder / name
    path.write_bytes(b"%PDG")
    assert what(store, kept) == [("attested_changed", path.name)]
    path.unlink()
    assert what(store, kept) == [("attested_missing", path.name)]


def test_a_forged_attestation_is_none(store: Store, key: SigningKey, tmp_path: Path) -> None:
    kept = attest(store, key).attestation
    changed = msgspec.structs.replace(kept, statement=kept.statement.replace("C-1", "C-9"))
    assert what(store, changed) == [("attestation_forged", "kept.json")]
    create_key(tmp_path / "other.pem")
    other = attest(store, SigningKey(tmp_path / "other.pem")).attestation
    found = against(store, other, "kept.json", fingerprint(key.public))
    assert [each.kind for each in found] == ["attestation_foreign"]
    assert against(store, kept, "kept.json", fingerprint(key.public)) == []
    elsewhere = Store.create(tmp_path / "O")
    assert what(elsewhere, kept) == [("attestation_foreign", "kept.json")]
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(StoreError, match="is no attestation"):
        read_attestation(tmp_path / "no.json")


@pytest.mark.long
def test_the_stores_own_attestations_are_a_chain(store: Store, key: SigningKey) -> None:
    paths = [attest(store, key).path for _ in range(3)]
    assert not [each for each in verify(store)[0].findings if "attest" in each.kind]
    second = json.loads(paths[1].read_text())
    paths[1].write_text(json.dumps(second, indent=1))
    found = [each for each in verify(store)[0].findings if "attest" in each.kind]
    assert [(each.kind, Path(each.where).name) for each in found] == [("attestation_changed", paths[1].name)]
    paths[1].unlink()
    found = [each for each in verify(store)[0].findings if "attest" in each.kind]
    assert ("attestation_changed", paths[1].name) in [(each.kind, Path(each.where).name) for each in found]


@pytest.mark.parametrize("is_recorded_first", [False, True])
@pytest.mark.parametrize("lost", [1, 4])
def test_a_lost_line_that_is_written_again_is_at_its_place(
    store: Store, key: SigningKey, lost: int, is_recorded_first: bool
) -> None:
    """The line after a lost one does not fit the chain any more, and is written again as well; by a recorder last."""
    kept = attest(store, key).attestation
    path = manifest_path(store)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(line for at, line in enumerate(lines, 1) if at != lost))
    listed = [entry.segment for entry in EventLog(store).listed] if is_recorded_first else []
    listed += [Path(action.where).name for action in recover(store) if action.what == "segment_listed"]
    assert listed == NAMES[lost - 1 : lost + 1]
    assert list(read_log_manifest(store).entries) == NAMES
    assert what(store, kept) == [("attested_relisted", name) for name in listed]
    assert verify(store)[0].is_sound


def test_keys_that_others_can_read_are_refused(key: SigningKey, tmp_path: Path) -> None:
    path = tmp_path / "keys" / "attest.pem"
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o644)
    with pytest.raises(BadInput, match="others can read it"):
        SigningKey(path)
    (tmp_path / "text.pem").write_text("no key")
    (tmp_path / "text.pem").chmod(0o600)
    with pytest.raises(BadInput, match="no private key"):
        SigningKey(tmp_path / "text.pem")


def test_a_damaged_manifest_is_not_signed(store: Store, key: SigningKey) -> None:
    content = manifest_path(store).read_bytes()
    manifest_path(store).write_bytes(content.replace(b'"samples":200', b'"samples":201', 1))
    with pytest.raises(StoreError, match="nothing is signed"):
        attest(store, key)


def test_commands(store: Store, tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    list(recover(store))
    words = ("--store", "S", "--key", "mine.pem")
    done = gyrofleet("attest", *words, "--out", "kept.json", "--json")
    assert done.code == 0, done.err
    signed = json.loads(done.out)
    assert signed["segments"] >= 4
    checked = ("verify", "--store", "S", "--against", "kept.json", "--json")
    assert gyrofleet(*checked, "--signed-by", signed["signed_by"]).code == 0
    assert gyrofleet(*checked, "--signed-by", "0" * 16).code == 1
    (store.folder / "certificates" / "C-1.pdf").write_bytes(b"other")
    found = gyrofleet(*checked)
    assert found.code == 1
    assert "attested_changed" in {each["kind"] for each in json.loads(found.out)["findings"]}
    assert "would lie among the files" in gyrofleet("attest", *words, "--out", "S/kept.json").err
    assert "--against FILE" in gyrofleet("verify", "--store", "S", "--signed-by", "ab").err


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInput, match="it is no file"):
        SigningKey(tmp_path / "pipe")
    with pytest.raises(StoreError, match="is no file"):
        read_attestation(tmp_path / "pipe")


def test_a_signature_that_is_no_text_of_base64_is_not_genuine(store: Store, key: SigningKey) -> None:
    signed = attest(store, key)[1]
    assert signed.is_genuine
    for wrong in ("é", "=", "\0", "x" * 88, ""):
        assert not msgspec.structs.replace(signed, signature=wrong).is_genuine


def test_what_the_newest_attestation_says_as_well_is_listed_once(
    store: Store, key: SigningKey, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    """It lies in the store, and is compared without being asked for."""
    (tmp_path / "a.json").write_bytes(attest(store, key).path.read_bytes())
    manifest = manifest_path(store)
    manifest.write_bytes(b"".join(manifest.read_bytes().splitlines(keepends=True)[:-1]))
    found = gyrofleet("verify", "--store", "S", "--against", "a.json", "--json").json["findings"]
    lost = [each["where"] for each in found if each["kind"] == "attested_missing"]
    assert lost == ["S/log/00000004.mcap"]
