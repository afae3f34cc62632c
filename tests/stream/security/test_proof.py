"""Proofs of sources: one for one recorder is put together and checked faster, and is the same to the last byte."""

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream.security.proof import Forged, Proof, SourceProver, SourceVerifier, joined, split
from stream.security.rights import Role
from tests.secured_sites import DAYS, credentials, make_site

KEY = "gyrofleet/plant/c1/U1/rate"
BODIES = (b"", b"\x08\x01" * 700, b'{"schema":1,"a":2}', b"x" * 100_000)


@pytest.fixture(params=[1, 2], ids=["one_recorder", "two_recorders"], scope="module")
def site(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "site"
    made = make_site(folder)
    if request.param == 2:
        made.add(Role.RECORDER, "second", days=DAYS)
    return folder


def test_a_proof_is_the_same_however_it_is_put_together(site: Path) -> None:
    prover, verifier = (
        SourceProver(credentials(site, "station:c1")),
        SourceVerifier(credentials(site, "recorder:recorder")),
    )
    for body in BODIES:
        for _ in range(3):  # the first is checked in full
            message = prover.prove(KEY, body)
            parts = split(message)
            assert parts.body == body
            assert parts.proof is not None
            assert joined(body, parts.proof) == message
            assert str(verifier.source_of(KEY, parts)) == "station c1"


def test_what_is_changed_is_refused_on_both_ways(site: Path) -> None:
    one, two = (SourceProver(credentials(site, f"station:{name}")) for name in ("c1", "c2"))
    other_site = site.parent / f"other-{site.name}"
    if not other_site.exists():
        make_site(other_site)
    stranger = SourceProver(credentials(other_site, "station:c1"))
    body = BODIES[1]
    for is_warm in (False, True):
        verifier = SourceVerifier(credentials(site, "recorder:recorder"))
        if is_warm:
            verifier.source_of(KEY, split(one.prove(KEY, body)))
            verifier.source_of(KEY, split(two.prove(KEY, body)))
        genuine = split(one.prove(KEY, body))
        assert genuine.packed is not None
        forged = [
            (KEY, genuine._replace(body=body[:-1] + b"\x02")),
            (KEY.replace("U1", "U2"), genuine),
            (KEY, split(joined(body, _flipped(genuine.proof)))),
            (KEY, genuine._replace(packed=genuine.packed.replace(b"station:c1", b"station:c2"))),
            (KEY, genuine._replace(packed=genuine.packed[:-2])),
            (KEY, genuine._replace(packed=genuine.packed + b"\xc4\x00")),
            (KEY, genuine._replace(packed=b"")),
            (KEY, genuine._replace(packed=None)),
            (KEY, split(stranger.prove(KEY, body))),
        ]
        for key, message in forged:
            with pytest.raises(Forged):
                verifier.source_of(key, message)
        assert str(verifier.source_of(KEY, genuine)) == "station c1"


def _flipped(proof: Proof | None) -> Proof:
    """A proof with one bit of the MAC for the recorder changed."""
    assert proof is not None
    mac = proof.macs["recorder:recorder"]
    changed = mac[:-1] + bytes([mac[-1] ^ 1])
    return msgspec.structs.replace(proof, macs={**proof.macs, "recorder:recorder": changed})


@given(st.binary(max_size=300))
def test_what_is_no_proof_is_left_in_the_message_or_refused(content: bytes) -> None:
    try:
        parts = split(content)
        proof = parts.proof
    except Forged:
        return
    if proof is None:
        assert parts.body == content
