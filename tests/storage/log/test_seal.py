"""Seals that version 0.1.0 of 2026-11-25 has written hold for ever: new fields change none that lacks them."""

from pathlib import Path

import pytest

from storage.log.store_documents import CanBeSealed, is_sealed, sealed
from storage.store import Store
from stream.events import CertificateIssued, SpecificationAction, SpecificationEntered

SPECIFICATION = SpecificationEntered(
    run="", t_ns=1, uid="u1", action=SpecificationAction.ADDED, name="fog", revision="A", content='revision = "A"\n',
    by="Li", reason="order 7", previous="ab" * 32, rejudges=True,
)  # fmt: skip
CERTIFICATE = CertificateIssued(
    run="", t_ns=2, uid="u2", number="GYL-2026-0001", unit="G-1", standard="JJF2014", language="both", sha256="1" * 64,
    digital_sha256="2" * 64, data_sha256="3" * 64, results="[]", runs=("r1", "r2"), valid_until="2027-03-01",
    by="Chen Gang", software="gyrofleet 0.1.0", specification="4" * 64, supersedes="GYL-2025-0009",
    reason="new standard",
)  # fmt: skip
BEFORE = (
    (SPECIFICATION, "39d56f36a92aa8cf63ba7634a6eeaa55fdf124c285e071d15f60b650423f6d22"),
    (CERTIFICATE, "90ac48fb4c45aa6d83931a7995d8e1fa9b48eccb26332117db8f4a9974a8d375"),
)


@pytest.mark.parametrize(("document", "seal"), BEFORE, ids=["specification", "certificate"])
def test_a_seal_of_before_holds(document: SpecificationEntered | CertificateIssued, seal: str, tmp_path: Path) -> None:
    store = Store(tmp_path, "5e" * 16)
    (tmp_path / "seal.key").write_bytes(bytes(range(32)))
    found: CanBeSealed = sealed(store, document)
    assert found.seal == seal
    assert is_sealed(store, found)
