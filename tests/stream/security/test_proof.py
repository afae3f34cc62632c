"""Proofs of sources: one for one recorder is put together and checked faster, and is the same to the last byte."""

import os
from concurrent.futures import ThreadPoolExecutor
from hashlib import blake2b
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream.security.proof import Forged, Proof, Proven, SourceProver, SourceVerifier, joined, shared_key, split
from stream.security.rights import Principal, Role
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
            source, opened = verifier.opened(KEY, message)
            assert (str(source), opened) == ("station c1", body)


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
            verifier.opened(KEY, one.prove(KEY, body))
            verifier.opened(KEY, two.prove(KEY, body))
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
            *((KEY, split(joined(body, _flipped(genuine.proof, at)))) for at in (0, 15, 16, 27, 28)),
        ]
        for key, message in forged:
            with pytest.raises(Forged):
                verifier.source_of(key, message)
            with pytest.raises(Forged):
                verifier.opened(key, _whole(message))
        assert str(verifier.source_of(KEY, genuine)) == "station c1"
        assert str(verifier.opened(KEY, _whole(genuine))[0]) == "station c1"


def test_every_changed_byte_and_every_shorter_message_is_refused(site: Path) -> None:
    message = SourceProver(credentials(site, "station:c1")).prove(KEY, BODIES[1])
    proof = split(message).proof
    assert proof is not None
    checked_to = len(message) if len(proof.macs) == 1 else len(BODIES[1])  # nobody checks the MAC for another recorder
    changed = [message[:at] + bytes([message[at] ^ 1]) + message[at + 1 :] for at in range(1300, checked_to)]
    for is_warm in (False, True):
        verifier = SourceVerifier(credentials(site, "recorder:recorder"))
        if is_warm:
            verifier.opened(KEY, message)
        for each in (*changed, *(message[:size] for size in (0, 1, 2, 40, len(message) - 1)), message[1:]):
            with pytest.raises(Forged):
                verifier.opened(KEY, each)


def test_a_proof_of_an_earlier_version_is_taken(site: Path) -> None:
    station, recorder = credentials(site, "station:c1"), credentials(site, "recorder:recorder")
    secret = shared_key(station, recorder.principal, station.principal, recorder.principal)
    context = b"gyrofleet message\0" + KEY.encode() + b"\0"
    mac = blake2b(context + BODIES[1], digest_size=16, key=secret).digest()
    proof = Proof("station:c1", {"recorder:recorder": mac})
    verifier = SourceVerifier(recorder)
    for _ in range(2):
        assert verifier.opened(KEY, joined(BODIES[1], proof)) == (Principal(Role.STATION, "c1"), BODIES[1])
        for at in (0, 15):
            with pytest.raises(Forged):
                verifier.opened(KEY, joined(BODIES[1], _flipped(proof, at)))


def test_what_is_signed_is_taken_whatever_mac_stands_beside_the_signature(site: Path) -> None:
    station = credentials(site, "station:c1")
    signature = split(SourceProver(station).prove("gyrofleet/plant/c1/event", BODIES[1])).proof
    assert signature is not None
    proof = msgspec.structs.replace(signature, macs={"recorder:recorder": bytes(44)})
    verifier = SourceVerifier(credentials(site, "recorder:recorder"))
    for _ in range(2):
        source, _ = verifier.opened("gyrofleet/plant/c1/event", joined(BODIES[1], proof))
        assert str(source) == "station c1"
    with pytest.raises(Forged):
        verifier.opened(KEY, joined(BODIES[1], proof))


def test_no_number_comes_twice_in_a_session(site: Path) -> None:
    """The key of a MAC must not see a number twice: neither from two threads, nor from a forked process."""
    prover = SourceProver(credentials(site, "station:c1"))
    with ThreadPoolExecutor(4) as threads:
        messages = list(threads.map(lambda _: prover.prove(KEY, BODIES[1]), range(2000)))
    read, write = os.pipe()
    if not (child := os.fork()):
        os.write(write, prover.prove(KEY, BODIES[1]))
        os._exit(0)
    os.waitpid(child, 0)
    messages += [os.read(read, 10_000), prover.prove(KEY, BODIES[1])]
    begun = [mac[:28] for each in messages if (proof := split(each).proof) for mac in [proof.macs["recorder:recorder"]]]
    assert len(set(begun)) == len(messages) == 2002
    assert len({each[:16] for each in begun}) == 2
    verifier = SourceVerifier(credentials(site, "recorder:recorder"))
    assert {str(verifier.opened(KEY, each)[0]) for each in messages} == {"station c1"}


def _whole(message: Proven) -> bytes:
    """A message as it is sent, with its proof as it is."""
    if message.packed is None:
        return message.body
    size = len(message.packed) + 2
    length = bytes((size & 127 | 128, size >> 7 & 127 | 128, size >> 14))
    return message.body + b"\x9a\x01" + length + message.packed + size.to_bytes(2, "little")


def _flipped(proof: Proof | None, at: int = -1) -> Proof:
    """A proof with one bit of the MAC for the recorder changed."""
    assert proof is not None
    mac = bytearray(proof.macs["recorder:recorder"])
    mac[at] ^= 1
    return msgspec.structs.replace(proof, macs={**proof.macs, "recorder:recorder": bytes(mac)})


@given(st.binary(max_size=300))
def test_what_is_no_proof_is_left_in_the_message_or_refused(content: bytes) -> None:
    try:
        parts = split(content)
        proof = parts.proof
    except Forged:
        return
    if proof is None:
        assert parts.body == content
