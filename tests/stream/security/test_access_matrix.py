"""Roles x keys x actions over real links: every cell as designed, nothing beyond it."""

import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import pytest

from stream.errors import BusError
from stream.security.credentials import BusSecurity, load_credentials
from stream.security.rights import MissingRight, Principal, Role
from stream.transport.zenoh_bus import Answers, ZenohBus
from tests.secured_sites import credentials, make_site, session

OWN, OTHER = "gyrofleet/plant/c1/U1/rate", "gyrofleet/plant/c2/U2/rate"
KEYS = {
    "own samples": OWN,
    "own events": "gyrofleet/plant/c1/event",
    "other samples": OTHER,
    "other events": "gyrofleet/plant/c2/event",
    "estimate": f"{OWN}/estimate/allan_deviation",
    "other estimate": f"{OTHER}/estimate/verdict",
    "compensated": "gyrofleet/plant/c2/U2/rate_compensated",
    "store events": "gyrofleet/store/lake/event",
    "entered": "gyrofleet/local/entered/event",
    "acknowledgement": "gyrofleet/@acknowledgement",
    "reply": "gyrofleet/@reply/1",
    "request": "gyrofleet/@request",
    "status": "gyrofleet/@status",
    "elsewhere": "other/plant/c1/U1/rate",
}
EVERYTHING = ["gyrofleet/**", "other/**", *(each for each in KEYS.values() if "@" in each)]
_CONTROL = {"acknowledgement", "reply"}
_ASK = {"request", "status"}
MAY_PUBLISH = {
    "station:c1": {"own samples", "own events"} | _ASK,
    "station:c2": {"other samples", "other events", "compensated"} | _ASK,
    "estimator:e1": {"estimate", "other estimate", "compensated", "own events", "other events", "store events",
                     "entered"} | _ASK,
    "approver:lead": {"store events", "entered", "request"},
    "fleet:head": set(),
    "recorder:recorder": {"store events", "entered", "request"} | _CONTROL,
}  # fmt: skip
_RECORDED = set(KEYS) - _CONTROL - _ASK - {"elsewhere"}
MAY_READ = {
    "station:c1": {"estimate"} | _CONTROL,
    "station:c2": {"other estimate"} | _CONTROL,
    "estimator:e1": _RECORDED | _CONTROL,
    "approver:lead": _CONTROL,
    "fleet:head": set(),
    "recorder:recorder": _RECORDED | _CONTROL | _ASK,
}
WHO = sorted(MAY_PUBLISH)
REPLICATION = "gyrofleet/@replication/plant/plant"


def test_every_role_publishes_reads_and_asks_what_it_may_and_nothing_else(tmp_path: Path, endpoint: str) -> None:
    make_site(tmp_path / "site")
    site = tmp_path / "site"
    arrived: set[tuple[str, str]] = set()
    read: set[tuple[str, str]] = set()
    answered: set[str] = set()
    with ExitStack() as stack:
        recorder = stack.enter_context(session(site, "recorder:recorder", listen=endpoint))
        for expression in EVERYTHING:
            recorder.subscribe(expression, lambda key, payload: arrived.add((payload.decode(), key)))
        recorder.answer("gyrofleet/@replication/**", lambda _key, _payload: b"segments")
        opened = {who: stack.enter_context(session(site, who, connect=endpoint, asks_itself=False)) for who in WHO}
        time.sleep(0.3)
        for who, bus in opened.items():
            for key in KEYS.values():
                bus.publish(key, who.encode())
        _wait_for(lambda: len(arrived) >= sum(map(len, MAY_PUBLISH.values())))
        for who, bus in opened.items():
            for key in KEYS.values():
                bus.subscribe(key, partial(_note, read, who))
        time.sleep(0.5)
        for key in KEYS.values():
            recorder.publish(key, b"sent")
        _wait_for(lambda: len(read) >= sum(map(len, MAY_READ.values())))
        asked = {who: bus.ask("gyrofleet/@replication/*/plant", timeout_s=1.0) for who, bus in opened.items()}
        answered = {who for who, answers in asked.items() if _content(answers) == [b"segments"]}
        named = {key: name for name, key in KEYS.items()}
        published = {who: {named[key] for by, key in arrived if by == who} for who in WHO}
        assert published == MAY_PUBLISH
        assert {who: {named[key] for by, key in read if by == who} for who in WHO} == MAY_READ
        assert answered == {"fleet:head"}


def test_this_side_names_the_right_that_is_missing(tmp_path: Path, endpoint: str) -> None:
    make_site(tmp_path)
    with ExitStack() as stack:
        stack.enter_context(session(tmp_path, "recorder:recorder", listen=endpoint))
        for who in WHO:
            bus = stack.enter_context(session(tmp_path, who, connect=endpoint))
            for name, key in KEYS.items():
                if name in MAY_PUBLISH[who]:
                    bus.publish(key, b"")
                else:
                    with pytest.raises(MissingRight, match=f"{who.replace(':', ' ')} may not publish {key}"):
                        bus.publish(key, b"")
        station = stack.enter_context(session(tmp_path, "station:c1", connect=endpoint))
        with pytest.raises(MissingRight, match="the station of that name may"):
            station.publish(OTHER, b"")
        with pytest.raises(MissingRight, match="certificate of role recorder may"):
            station.publish("gyrofleet/@acknowledgement", b"")
        with pytest.raises(MissingRight, match=r"may not read gyrofleet/\*\*"):
            station.subscribe("gyrofleet/**", lambda _key, _payload: None)


@pytest.mark.long
def test_a_revoked_and_an_unknown_principal_reach_nobody_and_learn_why(tmp_path: Path, endpoint: str) -> None:
    site = make_site(tmp_path)
    site.revoke(Principal(Role.STATION, "c2"))
    arrived: list[bytes] = []
    with session(tmp_path, "recorder:recorder", listen=endpoint) as recorder:
        recorder.subscribe("gyrofleet/**", lambda _key, payload: arrived.append(payload))
        site.add(Role.STATION, "c3", days=1.0)  # the recorder has not been started again since
        with (
            session(tmp_path, "station:c1", connect=endpoint) as good,
            session(tmp_path, "station:c2", connect=endpoint) as revoked,
            session(tmp_path, "station:c3", connect=endpoint) as unknown,
        ):
            revoked.publish(OTHER, b"revoked")
            unknown.publish("gyrofleet/plant/c3/U3/rate", b"unknown")
            time.sleep(0.3)
            good.publish(OWN, b"good")
            _wait_for(lambda: bool(arrived))
            assert arrived == [b"good"]
            assert "station c2 is revoked" in revoked.why_refused()
            assert "station c3 is not on the access list" in unknown.why_refused()
            assert good.why_refused() == ""


@pytest.mark.long
def test_an_expired_foreign_or_missing_certificate_opens_no_link(tmp_path: Path, endpoint: str) -> None:
    site = make_site(tmp_path / "site")
    make_site(tmp_path / "foreign")
    expired = site.add(Role.STATION, "late", days=2.0 / 86400.0)
    late = load_credentials(expired)
    mixed = tmp_path / "mixed"  # the key of a foreign site's c1 beside our site's certificate of authority
    shutil.copytree(tmp_path / "foreign/station/c1", mixed)
    shutil.copy(tmp_path / "site/ca.pem", mixed)
    with session(tmp_path / "site", "recorder:recorder", listen=endpoint):
        time.sleep(2.1)
        with pytest.raises(BusError, match=r"certificate of station late ended on .* site renew"):
            load_credentials(expired)
        plain = BusSecurity(is_insecure=True)
        foreign = BusSecurity(credentials(tmp_path / "foreign", "station:c1"))
        with pytest.raises(BusError, match="is not of the site"):
            load_credentials(mixed)
        for security in (BusSecurity(late), plain, foreign):
            with pytest.raises(BusError, match="cannot connect"):
                ZenohBus(connect=[endpoint], security=security)


@pytest.mark.long
def test_a_link_ends_with_its_certificate(tmp_path: Path, endpoint: str) -> None:
    site = make_site(tmp_path)
    site.add(Role.STATION, "brief", days=4.0 / 86400.0)
    arrived: list[bytes] = []
    with session(tmp_path, "recorder:recorder", listen=endpoint) as recorder:
        recorder.subscribe("gyrofleet/**", lambda _key, payload: arrived.append(payload))
        with session(tmp_path, "station:brief", connect=endpoint) as bus:
            key = "gyrofleet/plant/brief/U1/rate"
            bus.publish(key, b"in time")
            _wait_for(lambda: arrived == [b"in time"])
            time.sleep(4.5)
            bus.publish(key, b"late")
            time.sleep(0.5)
            assert arrived == [b"in time"]


def test_an_access_list_is_the_sites_own(tmp_path: Path) -> None:
    make_site(tmp_path / "a")
    make_site(tmp_path / "b")
    ours, foreign = tmp_path / "a/recorder/recorder", tmp_path / "b/recorder/recorder"
    shutil.copy(foreign / "access.json", ours)
    with pytest.raises(BusError, match="not signed by the site"):
        load_credentials(ours)


def _note(read: set[tuple[str, str]], who: str, key: str, payload: bytes) -> None:
    if payload == b"sent":
        read.add((who, key))


def _content(answers: Answers) -> list[bytes]:
    with suppress(BusError):
        return [content for _, content in answers.all()]
    return []


def _wait_for(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 5.0
    while not is_so() and time.monotonic() < until:
        time.sleep(0.02)
    time.sleep(0.3)  # and nothing more comes
