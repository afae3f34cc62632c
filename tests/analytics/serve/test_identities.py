"""What is done at the pages is of the user who has signed in; the holder of the server's token is nobody by name."""

import time
from pathlib import Path

import httpx
import pytest
from starlette.datastructures import Headers

from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import UsersFile
from stream.security.actor import UNAUTHENTICATED
from tests.analytics.serve.conftest import Served


@pytest.mark.parametrize(("role", "name", "identity"), [
    ("operator", "operator-program", "user:operator-program"), ("", "token", UNAUTHENTICATED),
])  # fmt: skip
def test_a_note_has_who_has_signed_in(role: str, name: str, identity: str, served: Served) -> None:
    with served.program(role) as client:
        answer = noted(client)
        document = answer.json()["document"]
        assert (document["author"], document["identity"]) == (name, identity)
        rows = client.get("/api/events", params={"kind": "NoteAdded", "by": name}).json()["events"]
        assert identity in {each["identity"] for each in rows}
        shown = client.get("/events", params={"kind": "NoteAdded", "by": name}).text
        assert ("(not proved)" in shown) is (identity == UNAUTHENTICATED)


def test_a_session_keeps_the_identity(served: Served) -> None:
    with served.browser("otto") as browser:
        assert noted(browser, {"X-CSRF-Token": browser.csrf}).json()["document"]["identity"] == "user:otto"


def noted(client: httpx.Client, headers: dict[str, str] | None = None) -> httpx.Response:
    """Add a note; another test may be writing the store at this moment."""
    for _ in range(100):
        answer = client.post("/api/notes", json={"run": "run-2", "text": "seen"}, headers=headers)
        if answer.status_code != 503:
            break
        time.sleep(0.1)
    assert answer.status_code == 200, answer.text
    return answer


def test_a_session_of_the_token_is_nobody_by_name(tmp_path: Path) -> None:
    (tmp_path / "users.toml").write_text("")
    door = Doorkeeper("T", Role.APPROVER, UsersFile(tmp_path / "users.toml"), "cookie", is_secure=False)
    cookie = door.begin_by_token("T", "127.0.0.1")
    assert cookie is not None
    person = door.identify(Headers(), {"cookie": cookie}, "127.0.0.1")
    assert person is not None
    assert (person.actor.name, person.actor.identity, person.csrf is None) == ("token", UNAUTHENTICATED, False)
