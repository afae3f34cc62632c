"""Certificates that are no good x roles x actions x keys: no link, or nothing passes it, and each refusal is named.

Beside it: what a good certificate may answer and delete. What each role may publish, read and ask is in
`test_access_matrix.py`, what a router may forge and replay in `tests/storage/recording/test_forgeries.py`.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from stream.errors import BusError
from stream.security.access import AccessList
from stream.security.credentials import BusSecurity, Credentials, load_credentials
from stream.security.rights import ACCESS_KEY, Principal
from stream.transport.zenoh_bus import Answers, ZenohBus
from tests.secured_sites import PEOPLE, credentials, make_site, session
from tests.stream.security.test_access_matrix import EVERYTHING, KEYS, REPLICATION

BRIEF_S = 2.0
ROLES = {f"{role}:{name}": (role, name) for role, name in PEOPLE}


@pytest.mark.long
@pytest.mark.parametrize("who", ROLES)
def test_no_link_for_a_certificate_that_is_no_good(who: str, tmp_path: Path, endpoint: str) -> None:
    """Expired, of another authority, none at all, and plain TCP: for every role, in both directions."""
    site = make_site(tmp_path / "site")
    make_site(tmp_path / "foreign")
    role, name = ROLES[who]
    late = load_credentials(site.add(role, f"{name}-late", days=BRIEF_S / 86400.0))
    arrived: list[bytes] = []
    with session(tmp_path / "site", "recorder:recorder", listen=endpoint) as recorder:
        for expression in EVERYTHING:
            recorder.subscribe(expression, lambda _key, payload: arrived.append(payload))
        time.sleep(BRIEF_S + 0.1)
        bad = {
            "expired": BusSecurity(late),
            "foreign": BusSecurity(credentials(tmp_path / "foreign", who)),
            "plain": BusSecurity(is_insecure=True),
        }
        for security in bad.values():
            with pytest.raises(BusError, match=r"cannot connect to .*(certificates of one site|require certificates)"):
                ZenohBus(connect=[endpoint], security=security)
        assert _opened_without_a_certificate(endpoint, tmp_path / "site/recorder/recorder/ca.pem") is False
        with pytest.raises(BusError, match=r"certificate of .* ended on .*site renew"):
            load_credentials(late.folder)
    assert arrived == []


@pytest.mark.in_gate("revoked-station:c1", "unknown-approver:lead")
@pytest.mark.parametrize("who", ROLES)
@pytest.mark.parametrize("why", ["revoked", "unknown"])
def test_nothing_passes_for_who_is_not_on_the_list(why: str, who: str, tmp_path: Path, endpoint: str) -> None:
    """The link is there, since the certificate is of the site: every action on every key comes to nothing."""
    site = make_site(tmp_path)
    role, name = ROLES[who]
    principal = Principal(role, f"{name}-x")
    folder = site.add(role, principal.name, days=1.0)
    if why == "revoked":
        site.revoke(principal)
    arrived: list[str] = []
    asked: list[str] = []
    seen: list[str] = []
    with ExitStack() as stack:
        if why == "unknown":  # the recorder has the list of before
            before = credentials(tmp_path, "recorder:recorder")
            listed = _without(before, principal)
            recorder = stack.enter_context(ZenohBus(listen=[endpoint], security=BusSecurity(listed)))
        else:
            recorder = stack.enter_context(session(tmp_path, "recorder:recorder", listen=endpoint))
        for expression in EVERYTHING:
            recorder.subscribe(expression, lambda key, payload: arrived.append(key) if payload != b"genuine" else None)
        recorder.answer("gyrofleet/@replication/**", lambda key, _payload: _segments(asked, key))
        bus = stack.enter_context(ZenohBus(connect=[endpoint], security=BusSecurity(load_credentials(folder))))
        bus._is_trusted = True  # it tries what it may not
        for key in KEYS.values():
            # its own puts reach its own subscribers
            bus.subscribe(key, lambda key, payload: seen.append(key) if payload == b"genuine" else None)
            bus.answer(key, lambda _key, _payload: b"forged")
        time.sleep(0.3)
        for key in KEYS.values():
            bus.publish(key, b"forged")
            bus._session.delete(key)
            recorder.publish(key, b"genuine")
        assert bus.ask(REPLICATION, timeout_s=0.5).all() == []
        answers = [recorder.ask(key, timeout_s=0.3).all() for key in list(KEYS.values())[:3]]
        assert [each for found in answers for _, each in found if each == b"forged"] == []
        bus._is_trusted = False
        expected = "is revoked" if why == "revoked" else "is not on the access list"
        assert expected in bus.why_refused()
        assert (arrived, asked, seen) == ([], [], [])


MAY_ANSWER = {"recorder:recorder": {"replication", "access"}}


@pytest.mark.in_gate("station:c1", "recorder:recorder")
@pytest.mark.parametrize("who", [who for who in ROLES if not who.startswith("router")])
def test_who_may_answer_questions(who: str, tmp_path: Path, endpoint: str) -> None:
    """Nobody answers in a recorder's place, about access, plants or samples; a recorder does, also behind a router."""
    make_site(tmp_path)
    questions = {"replication": "gyrofleet/@replication/plant/plant", "access": ACCESS_KEY, **KEYS}
    with (
        session(tmp_path, "router:router", listen=endpoint) as router,
        session(tmp_path, who, connect=endpoint, asks_itself=False) as answering,
    ):
        for key in questions.values():
            answering.answer(key, lambda _key, _payload: b"mine")
        time.sleep(0.3)
        asked: dict[str, Answers] = {
            name: router.ask(key, timeout_s=0.5, asks_all=True) for name, key in questions.items()
        }
        answered = {name for name, found in asked.items() if _has(found, b"mine")}
    assert answered == MAY_ANSWER.get(who, set())


def test_who_may_not_publish_may_not_delete_either(tmp_path: Path, endpoint: str) -> None:
    make_site(tmp_path)
    deleted: list[str] = []
    with session(tmp_path, "recorder:recorder", listen=endpoint) as recorder:
        recorder.subscribe("gyrofleet/**", lambda key, _payload: deleted.append(key))
        with session(tmp_path, "station:c1", connect=endpoint) as station:
            station._session.delete("gyrofleet/plant/c2/U2/rate")
            station._session.delete("gyrofleet/plant/c1/U1/rate")
            _wait_for(lambda: bool(deleted))
    assert deleted == ["gyrofleet/plant/c1/U1/rate"]


def _without(own: Credentials, principal: Principal) -> Credentials:
    """Credentials with the access list of before a principal was added."""
    access = own.access
    admitted = {each: key for each, key in access.admitted.items() if each != principal}
    return replace(own, access=AccessList(admitted, access.revoked, access.at_ns, access.rules))


def _opened_without_a_certificate(endpoint: str, site: Path) -> bool:
    """Whether TLS without a certificate of this side opens a session, in a process of its own."""
    script = (
        "import sys, zenoh, json\n"
        "c = zenoh.Config()\n"
        "for k, v in json.loads(sys.argv[1]).items(): c.insert_json5(k, json.dumps(v))\n"
        "zenoh.open(c)\n"
    )
    settings = {
        "mode": "client", "connect/endpoints": [endpoint.replace("tcp/", "tls/")], "connect/timeout_ms": 3000,
        "scouting/multicast/enabled": False, "transport/link/protocols": ["tls"],
        "transport/link/tls/root_ca_certificate": str(site),
    }  # fmt: skip
    done = subprocess.run([sys.executable, "-c", script, json.dumps(settings)], capture_output=True, check=False)
    return done.returncode == 0


def _segments(asked: list[str], key: str) -> bytes:
    asked.append(key)
    return b"segments"


def _has(answers: Answers, content: bytes) -> bool:
    try:
        return any(each == content for _, each in answers.all())
    except BusError:
        return False


def _wait_for(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 5.0
    while not is_so() and time.monotonic() < until:
        time.sleep(0.02)
    time.sleep(0.3)
