"""The role that attests: what is wrong is a trouble that passes, and no end."""

import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.attestation.attestation import kept_attestations
from storage.attestation.signing_key import SigningKey
from storage.check.attesting import AttestService
from storage.check.recover import recover
from storage.recording.store_status import store_status
from storage.store import Store
from stream.errors import StoreError
from tests.storage.verified_store import damage_last_chunk, filled


def mend(store: Store) -> None:
    list(recover(store))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return filled(tmp_path / "S", range(4), then=mend)


def test_an_unsound_store_is_a_trouble_until_it_is_sound(store: Store, key: SigningKey) -> None:
    service = AttestService(store, key, verifies=True)
    assert service.round().attestation.stated.unverified == ()
    assert service.status().trouble == ""
    before = (store.log / "00000001.mcap").read_bytes()
    damage_last_chunk(store.log / "00000001.mcap")
    with pytest.raises(StoreError, match="nothing is signed"):
        service.round()
    assert "00000001.mcap" in service.status().trouble
    (store.log / "00000001.mcap").write_bytes(before)
    service.round()
    found = service.status()
    assert (found.trouble, found.numbers["attestations_total"]) == ("", 2.0)
    assert len(kept_attestations(store)) == 2


def test_a_copy_that_cannot_be_written_is_a_trouble(store: Store, key: SigningKey, tmp_path: Path) -> None:
    service = AttestService(store, key, out=tmp_path / "usb" / "attested.json")
    with pytest.raises(StoreError, match="the attestation is kept as"):
        service.round()
    assert "usb" in service.status().trouble
    (tmp_path / "usb").mkdir()
    service.round()
    assert service.status().trouble == ""


def test_a_place_that_cannot_be_written_is_known_before_anything_is_signed(
    store: Store, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    for out, why in ((tmp_path / "missing" / "a.json", "cannot be written"), (tmp_path, "is a directory")):
        done = gyrofleet("attest", "--store", store.folder, "--key", tmp_path / "k.pem", "--out", out)
        assert done.code in (1, 2)  # 2: the argument is a folder
        assert why in " ".join(done.err.split())
    assert kept_attestations(store) == []


def test_the_role_goes_on_and_is_in_the_status(
    store: Store, tmp_path: Path, spawn: Callable[..., subprocess.Popen[str]]
) -> None:
    damage_last_chunk(store.log / "00000001.mcap")
    role = spawn(
        "attest", "--store", store.folder, "--key", tmp_path / "k.pem", "--verify", "--every-h", "0.01", "--json"
    )
    until = time.monotonic() + 30.0
    while not any("not sound" in each for each in store_status(store).troubles):
        assert role.poll() is None
        assert time.monotonic() < until
        time.sleep(0.1)


def test_lines_of_the_role_have_their_time_and_are_not_wrapped(
    store: Store, tmp_path: Path, spawn: Callable[..., subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    role = spawn("attest", "--store", store.folder, "--key", tmp_path / "k.pem", "--every-h", "1")
    assert role.stderr is not None
    made, attested = role.stderr.readline(), role.stderr.readline()
    role.terminate()
    out, _ = role.communicate(timeout=30)
    assert (role.returncode, out) == (0, "")
    for line in (made, attested):
        assert re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d ", line), line
    assert "1 segment and " in attested
    assert " signed by " in attested
