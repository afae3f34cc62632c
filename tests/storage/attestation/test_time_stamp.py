"""An attestation proves its time by an authority's stamp; one of anything else, or by anybody, does not hold."""

import base64
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography.x509.oid import ExtendedKeyUsageOID

from storage.attestation.attestation import Attestation, attest, read_attestation
from storage.attestation.comparison import against
from storage.attestation.signing_key import SigningKey, create_key
from storage.attestation.time_stamp import check_stamp, read_roots, request_stamp
from storage.check.verify import verify
from storage.store import Store
from stream.errors import BadInput, StoreError
from tests.storage.attestation.time_stamp_authority import MOMENT, Authority, serving
from tests.storage.verified_store import filled


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Authority]:
    with serving(Authority(tmp_path_factory.mktemp("tsa"))) as found:
        yield found


@pytest.fixture
def honest(authority: Authority) -> Authority:
    authority.fault = ""
    return authority


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return filled(tmp_path / "S", range(2))


@pytest.fixture
def key(tmp_path: Path) -> SigningKey:
    create_key(tmp_path / "attest.pem")
    return SigningKey(tmp_path / "attest.pem")


def problems(store: Store, attestation: Attestation, root: Path | None) -> list[tuple[str, str]]:
    roots = None if root is None else read_roots(root)
    return [(each.kind, each.what) for each in against(store, attestation, "kept.json", roots=roots)]


def test_a_stamp_proves_the_moment(store: Store, key: SigningKey, honest: Authority) -> None:
    done = attest(store, key, timestamp_url=honest.url)
    assert done.unstamped == ""
    kept = read_attestation(done.path)
    found = check_stamp(kept.time_stamp, kept.signature_bytes, read_roots(honest.root))
    assert (found.at, found.by, found.is_trusted, found.why_not) == (MOMENT, "CN=Test TSA", True, "")
    assert problems(store, kept, honest.root) == []
    assert problems(store, kept, None) == []
    assert not check_stamp(kept.time_stamp, kept.signature_bytes, None).is_trusted
    assert verify(store)[0].is_sound


def test_a_stamp_by_nobody_known_or_of_something_else_does_not_hold(
    store: Store, key: SigningKey, honest: Authority, tmp_path: Path
) -> None:
    first, second = (attest(store, key, timestamp_url=honest.url).attestation for _ in range(2))
    stranger = Authority(tmp_path)
    assert [kind for kind, _ in problems(store, first, stranger.root)] == ["attestation_stamp_invalid"]
    moved = msgspec.structs.replace(second, time_stamp=first.time_stamp)
    for root in (honest.root, None):
        assert problems(store, moved, root) == [
            ("attestation_stamp_invalid", "its time stamp does not hold: it is of another signature")
        ]
    broken = msgspec.structs.replace(first, time_stamp=first.time_stamp[:-40])
    (found,) = problems(store, broken, None)
    assert "it cannot be read" in found[1]
    bare = msgspec.structs.replace(first, time_stamp="")
    assert problems(store, bare, honest.root) == [("attestation_unstamped", "it has no time stamp")]
    assert problems(store, bare, None) == []


def test_every_changed_byte_of_a_stamp_is_found(store: Store, key: SigningKey, honest: Authority) -> None:
    kept = attest(store, key, timestamp_url=honest.url).attestation
    roots = read_roots(honest.root)
    content = base64.b64decode(kept.time_stamp)
    held = []
    for at in range(0, len(content), 7):
        changed = bytearray(content)
        changed[at] ^= 1
        stamp = base64.b64encode(bytes(changed)).decode()
        if check_stamp(stamp, kept.signature_bytes, roots).is_trusted:
            held.append(at)
    # a byte that is changed in what neither signature nor chain covers may not change what the stamp says
    for at in held:
        changed = bytearray(content)
        changed[at] ^= 1
        assert check_stamp(base64.b64encode(bytes(changed)).decode(), kept.signature_bytes, roots).at == MOMENT
    assert len(held) <= len(content) // 7 // 20


def test_an_authority_without_the_purpose_is_not_believed(store: Store, key: SigningKey, tmp_path: Path) -> None:
    with serving(Authority(tmp_path, usage=ExtendedKeyUsageOID.SERVER_AUTH)) as web:
        kept = attest(store, key, timestamp_url=web.url).attestation
        (found,) = problems(store, kept, web.root)
    assert found[0] == "attestation_stamp_invalid"


@pytest.mark.parametrize(
    ("fault", "why"),
    [("refuses", "refuses: not today"), ("garbage", "no time stamp"), ("another", "something else"),
     ("replayed", "an earlier request")],
)  # fmt: skip
def test_without_a_good_answer_it_is_attested_all_the_same(
    fault: str, why: str, store: Store, key: SigningKey, authority: Authority
) -> None:
    authority.fault = fault
    done = attest(store, key, timestamp_url=authority.url)
    assert why in done.unstamped
    assert read_attestation(done.path).time_stamp == ""
    assert problems(store, done.attestation, None) == []


def test_a_clock_that_was_ahead_is_noted(store: Store, key: SigningKey, honest: Authority) -> None:
    kept = attest(store, key, timestamp_url=honest.url).attestation
    stated = kept.stated
    late = msgspec.structs.replace(stated, at_ns=int(MOMENT.timestamp() * 1e9) + 600 * 10**9)
    text = msgspec.json.encode(late).decode()
    signature = key.sign(text.encode())
    signed = Attestation(
        statement=text, public_key=key.public.hex(), signature=base64.b64encode(signature).decode(),
        time_stamp=request_stamp(honest.url, signature),
    )  # fmt: skip
    assert problems(store, signed, honest.root) == [
        ("attestation_clock", "it states a time 600 s after its time stamp: the clock of the store was ahead then")
    ]


def test_an_address_that_is_none_and_nobody_there_are_named() -> None:
    with pytest.raises(BadInput, match="begins with https:// or http://"):
        request_stamp("file:///etc/passwd", b"x")
    with pytest.raises(StoreError, match="does not answer"):
        request_stamp("http://127.0.0.1:1/", b"x")


@pytest.mark.long
def test_the_commands_stamp_and_check(
    store: Store, honest: Authority, gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    words = ("attest", "--store", "S", "--key", "k.pem", "--out", "out.json", "--timestamp-url", honest.url, "--json")
    done = gyrofleet(*words)
    assert (done.code, done.json["is_stamped"]) == (0, True)
    check = ("verify", "--store", "S", "--against", "out.json")
    good = gyrofleet(*check, "--timestamp-root", honest.root, "--json")
    assert good.code == 0
    assert good.json["time_stamp"] == {"at": "2027-01-02T03:04:05Z", "by": "CN=Test TSA", "is_trusted": True}
    assert "whether to trust it" in gyrofleet(*check).out
    stranger = Authority(tmp_path)
    assert gyrofleet(*check, "--timestamp-root", stranger.root).code == 1
    honest.fault = "refuses"
    without = gyrofleet(*words)
    assert (without.code, without.json["is_stamped"]) == (1, False)
    assert "attested without a time stamp" in without.err
    assert gyrofleet(*check, "--timestamp-root", honest.root).code == 1  # it has none
