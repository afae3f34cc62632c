"""A verification that builds on an earlier one finds what a whole one finds."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from storage.attestation.attestation import Attested, attest
from storage.attestation.signing_key import SigningKey
from storage.attestation.verified_state import newest_verified_state, verified_state
from storage.check.recover import recover
from storage.check.verify import verify
from storage.findings import Verification
from storage.manifests.log import read_log_manifest, rewrite_manifest
from storage.segments.disk import sha256_of
from storage.store import Store
from stream.errors import StoreError
from tests.storage.verified_store import damage_last_chunk, fill, filled

ATTESTED = 6
MORE = range(2 * ATTESTED, 2 * ATTESTED + 2)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Segments with two messages each, and their lake."""
    return filled(tmp_path / "S", *(range(2 * number, 2 * number + 2) for number in range(ATTESTED)), then=mend)


def mend(store: Store) -> None:
    list(recover(store))
    assert verify(store)[0].is_sound


def verified_and_attested(store: Store, key: SigningKey) -> Attested:
    found, state = verify(store)
    assert found.is_sound
    return attest(store, key, verified=dict(state.entries))


def both(store: Store, path: Path) -> tuple[Verification, Verification]:
    """A verification since an attestation and a whole one, which must agree in all but what was read."""
    since, whole = verify(store, since=verified_state(store, path))[0], verify(store)[0]
    alike = [msgspec.structs.replace(each, seconds=0.0, compared=0, since="") for each in (since, whole)]
    assert alike[0] == alike[1]
    return since, whole


def test_what_was_verified_is_compared_and_what_came_since_is_read(store: Store, key: SigningKey) -> None:
    path = verified_and_attested(store, key).path
    assert both(store, path)[0].compared == ATTESTED
    fill(store, MORE)
    mend(store)
    since, whole = both(store, path)
    assert (since.segments - since.compared, since.samples) == (whole.segments - ATTESTED, 100 * MORE.stop)
    newer = verified_and_attested(store, key).path
    assert both(store, newer)[0].compared == whole.segments


@pytest.mark.parametrize(("segments", "bytes_each"), [(2, 1), pytest.param(ATTESTED, 3, marks=pytest.mark.long)])
def test_any_changed_byte_of_an_attested_segment_is_found(
    store: Store, key: SigningKey, segments: int, bytes_each: int
) -> None:
    path = verified_and_attested(store, key).path
    rng = np.random.default_rng(7)
    for segment in sorted(store.log.glob("*.mcap"))[:segments] * bytes_each:
        content = segment.read_bytes()
        changed = bytearray(content)
        changed[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        segment.write_bytes(changed)
        since, _ = both(store, path)
        assert {(each.kind, Path(each.where).name) for each in since.findings} >= {("segment_damaged", segment.name)}
        assert (since.compared, since.since) == (0, ""), "everything was read"
        segment.write_bytes(content)
    assert both(store, path)[0].compared == ATTESTED


def test_a_replaced_segment_with_a_valid_chain_is_read_and_named(store: Store, key: SigningKey) -> None:
    path = verified_and_attested(store, key).path
    entries = {**read_log_manifest(store).entries}
    name = sorted(entries)[1]
    damage_last_chunk(store.log / name)
    entries[name] = msgspec.structs.replace(entries[name], sha256=sha256_of(store.log / name))
    rewrite_manifest(store, entries.values())
    since, _ = both(store, path)
    assert {"attested_changed", "segment_damaged"} <= {each.kind for each in since.findings}


def lose(store: Store, first: int) -> None:
    """Record two segments, and remove the former and its line."""
    before = set(store.log.glob("*.mcap"))
    fill(store, range(first, first + 1))
    (lost,) = set(store.log.glob("*.mcap")) - before
    fill(store, range(first + 1, first + 2))
    lost.unlink()
    rewrite_manifest(store, [each for each in read_log_manifest(store).entries.values() if each.segment != lost.name])


def losses(found: Verification) -> list[str]:
    return [each.kind for each in found.findings if each.severity == "loss"]


@pytest.mark.long
def test_numbers_are_followed_over_the_attestation(store: Store, key: SigningKey) -> None:
    path = verified_and_attested(store, key).path
    fill(store, MORE[:1])
    assert losses(both(store, path)[0]) == []
    lose(store, MORE[1])
    assert losses(both(store, path)[0]) == ["numbers_missing"]


@pytest.mark.long
def test_a_missing_segment_is_found(store: Store, key: SigningKey) -> None:
    path = verified_and_attested(store, key).path
    min(store.log.glob("*.mcap")).unlink()
    assert "segment_missing" in {each.kind for each in both(store, path)[0].findings}


def test_a_verified_segment_that_is_not_listed_any_more_is_missed(store: Store, key: SigningKey) -> None:
    """Between two others, with a valid chain and without the attestation in the store and the lake: none else knows."""
    kept = verified_and_attested(store, key).path
    path = kept.rename(store.folder.parent / "kept.json")
    name = sorted(read_log_manifest(store).entries)[2]
    (store.log / name).unlink()
    rewrite_manifest(store, [each for each in read_log_manifest(store).entries.values() if each.segment != name])
    shutil.rmtree(store.lake)
    since, _ = both(store, path)
    assert "numbers_missing" in {each.kind for each in since.findings}
    assert since.compared == 0


@pytest.mark.long
def test_a_loss_that_was_documented_before_stays_explained(store: Store, key: SigningKey) -> None:
    damage_last_chunk(sorted(store.log.glob("*.mcap"))[2])
    mend(store)
    path = verified_and_attested(store, key).path
    since = verify(store, since=verified_state(store, path))[0]
    assert since.is_sound
    assert since.compared == since.segments
    lose(store, MORE[0])  # to explain it, the documents of the first are read as well
    assert losses(both(store, path)[0]) == ["numbers_missing"]


@pytest.mark.long
def test_segments_sealed_between_verification_and_signature_are_read(store: Store, key: SigningKey) -> None:
    verified = dict(verify(store)[1].entries)
    fill(store, MORE)
    mend(store)
    kept = attest(store, key, verified=verified)
    unverified = kept.attestation.stated.unverified
    assert unverified is not None
    assert set(unverified) == {path.name for path in store.log.glob("*.mcap")} - set(verified)
    assert both(store, kept.path)[0].compared == ATTESTED


def test_attestations_that_prove_no_verification_are_refused(store: Store, key: SigningKey, tmp_path: Path) -> None:
    plain = attest(store, key)
    with pytest.raises(StoreError, match="does not say that the store was verified"):
        verified_state(store, plain.path)
    assert newest_verified_state(store) is None
    kept = verified_and_attested(store, key)
    with pytest.raises(StoreError, match="signed by the key"):
        verified_state(store, kept.path, "0" * 16)
    with pytest.raises(StoreError, match="is of the store"):
        verified_state(Store.create(tmp_path / "O"), kept.path)
    lie = msgspec.structs.replace(plain.attestation, statement=kept.attestation.statement)
    (tmp_path / "lie.json").write_bytes(msgspec.json.encode(lie))
    with pytest.raises(StoreError, match="its signature is not"):
        verified_state(store, tmp_path / "lie.json")
    assert newest_verified_state(store, "0" * 16) is None


@pytest.mark.parametrize("named", [("last",), pytest.param(("kept.json", "last"), marks=pytest.mark.long)])
def test_commands(store: Store, tmp_path: Path, gyrofleet: Callable[..., Any], named: tuple[str, ...]) -> None:
    words = ("--store", "S", "--key", "mine.pem")
    checked = ("verify", "--store", "S", "--since")
    assert "`gyrofleet attest --verify --store S` makes one" in gyrofleet(*checked, "last").err
    signed = gyrofleet("attest", *words, "--verify", "--out", "kept.json", "--json")
    assert (signed.code, signed.json["unverified"]) == (0, 0), signed.err
    fill(store, MORE)
    mend(store)
    segments = len(list(store.log.glob("*.mcap")))
    for since in named:
        found = gyrofleet(*checked, since, "--json")
        assert (found.code, found.json["compared"], found.json["segments"]) == (0, ATTESTED, segments), found.err
    shown = gyrofleet(*checked, "last", "--signed-by", signed.json["signed_by"]).out
    assert f"{ATTESTED} segments had been verified before" in shown
    second = gyrofleet("attest", *words, "--verify")
    assert "the store was verified before and is sound" in second.out
    damage_last_chunk(store.log / "00000002.mcap")
    refused = gyrofleet("attest", *words, "--verify")
    assert refused.code == 1
    assert "is not sound, nothing is signed" in refused.err
    assert len(list((store.folder / "attestations").glob("*.json"))) == 2
    found = gyrofleet(*checked, "last")
    assert found.code == 1
    assert "everything was read: something is damaged or lost" in " ".join(found.out.split())
    assert json.loads((tmp_path / "kept.json").read_text())["public_key"]
