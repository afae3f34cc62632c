"""Tries are limited, sessions end, passwords are hashed: with a clock that the test holds."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.passwords import LEAST_CHARACTERS, hashed, matches
from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Role
from analytics.serve.doors.sessions import IDLE_S, LONGEST_S, Sessions
from analytics.serve.doors.users_file import UsersFile
from analytics.serve.problems import TooMany
from stream.errors import BadInput
from tests.analytics.serve.conftest import PASSWORD, write_users


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def keeper(tmp_path: Path, clock: Clock) -> Doorkeeper:
    write_users(tmp_path / "users.toml")
    return Doorkeeper(
        token="T", token_role=Role.VIEWER, users=UsersFile(tmp_path / "users.toml"), cookie="cookie", is_secure=False,
        sessions=Sessions(clock), wrong_logins=RateLimit(3, 10.0, clock),
    )  # fmt: skip


def test_after_some_wrong_passwords_an_address_waits(tmp_path: Path) -> None:
    clock = Clock()
    doors = keeper(tmp_path, clock)
    for name in ("vera", "otto", "nobody"):
        assert doors.begin_by_password(name, "wrong", "10.0.0.1") is None
    with pytest.raises(TooMany, match="try again in 10 s"):
        doors.begin_by_password("vera", PASSWORD, "10.0.0.1")
    assert doors.begin_by_password("vera", PASSWORD, "10.0.0.2") is not None
    clock.now_s = 11.0
    assert doors.begin_by_password("vera", PASSWORD, "10.0.0.1") is not None


def test_a_user_is_not_guessed_from_many_addresses(tmp_path: Path) -> None:
    doors = keeper(tmp_path, Clock())
    for address in ("10.0.0.1", "10.0.0.2", "10.0.0.3"):
        assert doors.begin_by_password("vera", "wrong", address) is None
    with pytest.raises(TooMany):
        doors.begin_by_password("vera", PASSWORD, "10.0.0.4")
    assert doors.begin_by_password("otto", PASSWORD, "10.0.0.4") is not None


def test_logins_that_succeed_are_not_counted(tmp_path: Path) -> None:
    doors = keeper(tmp_path, Clock())
    assert all(doors.begin_by_password("vera", PASSWORD, "10.0.0.1") for _ in range(10))


def test_a_session_ends_when_it_is_not_used_and_at_last() -> None:
    clock = Clock()
    sessions = Sessions(clock)
    used, left = sessions.begin("a", "x"), sessions.begin("b", "x")
    while clock.now_s <= LONGEST_S - IDLE_S:
        clock.now_s += IDLE_S - 1.0
        assert sessions.find(used) is not None
    assert sessions.find(left) is None
    clock.now_s = LONGEST_S + 1.0
    assert sessions.find(used) is None


def test_a_session_may_end_earlier() -> None:
    clock = Clock()
    sessions = Sessions(clock)
    short = sessions.begin("a", "", 600.0, Role.VIEWER)
    clock.now_s = 599.0
    assert sessions.find(short) is not None
    clock.now_s = 601.0
    assert sessions.find(short) is None


def test_many_tries_at_once_are_no_more_than_may_be(tmp_path: Path) -> None:
    """Each waits in the hash while the others are let in: what counts is how many were hashed."""
    doors = keeper(tmp_path, Clock())

    def one(_: int) -> bool:
        try:
            return doors.begin_by_password("vera", "wrong", "10.0.0.1") is None
        except TooMany:
            return False

    with ThreadPoolExecutor(40) as threads:
        assert sum(threads.map(one, range(40))) == 3


@pytest.mark.long
def test_a_password_is_stored_as_a_slow_hash_with_its_own_salt() -> None:
    one, two = hashed(PASSWORD), hashed(PASSWORD)
    assert one != two
    assert PASSWORD not in one
    assert matches(PASSWORD, one)
    assert not matches(PASSWORD + "x", one)
    with pytest.raises(BadInput, match="characters"):
        hashed("x" * (LEAST_CHARACTERS - 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[users.a]\nrole = 'boss'\npassword = 'x'", "users"),
        ("[users.a]\nrole = 'viewer'", "needs a password or a token_sha256"),
        ("[users.a]\nrole = 'viewer'\npassword = 'plain text'", "is not hashed"),
        ("[users.a]\nrole = 'viewer'\ntoken_sha256 = 'x'", "64 hexadecimal digits"),
        ("[users.'a b']\nrole = 'viewer'\npassword = 'x'", "cannot be a user's name"),
        ("users = 3", "users"),
    ],
)
def test_a_file_of_users_that_is_not_right_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "users.toml").write_text(text)
    with pytest.raises(BadInput, match=message):
        UsersFile(tmp_path / "users.toml")
