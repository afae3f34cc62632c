"""A key that signs attestations."""

from pathlib import Path

import pytest

from storage.attestation.signing_key import SigningKey, create_key


@pytest.fixture
def key(tmp_path: Path) -> SigningKey:
    create_key(tmp_path / "keys" / "attest.pem")
    return SigningKey(tmp_path / "keys" / "attest.pem")
