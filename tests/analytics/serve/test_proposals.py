"""Two persons at the pages and over the API: an engineer proposes, an approver approves, nobody their own."""

from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from analytics.loop.model.model_registry import ModelRegistry
from storage.store import Store
from tests.analytics.loop.test_model_registry import version
from tests.analytics.serve.conftest import PASSWORD, TOKEN, Browser, start, write_users
from tests.forked_commands import CommandServer

PROMOTION = {"version": 1, "reason": "better on three runs"}


@pytest.fixture(scope="module")
def site(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[tuple[str, dict[str, str]]]:
    """A server over a store with a version of an error model, which asks for two persons for models."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "a.csv").write_text("time[s],rate[deg/s]\n" + "".join(f"{i / 10},{i % 3}\n" for i in range(100)))
    done = run_command("import", "a.csv", "--unit", "U1", "--run", "r1", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    ModelRegistry(Store.open(folder / "S")).add(version())
    (folder / "S/site.toml").write_text('two_persons = ["models"]\n')
    tokens = write_users(folder / "users.toml")
    process, ready = start(
        command_server, "--store", "S", "--port", 0, "--token", TOKEN, "--token-role", "approver", "--users",
        "users.toml", cwd=folder,
    )  # fmt: skip
    yield ready["url"], tokens
    process.terminate()
    _, err = process.communicate(timeout=30)
    assert "Traceback" not in err, err


def test_an_engineer_proposes_and_an_approver_approves(site: tuple[str, dict[str, str]]) -> None:
    url, tokens = site

    def post(role: str, path: str, **given: object) -> httpx.Response:
        token = tokens.get(role, TOKEN)
        return httpx.post(f"{url}{path}", json=given, headers={"Authorization": f"Bearer {token}"}, timeout=60.0)

    def stage() -> str:
        answer = httpx.get(f"{url}/api/diagnosis/U1", headers={"Authorization": f"Bearer {TOKEN}"}, timeout=60.0)
        (found,) = answer.json()["versions"]
        return str(found["stage"])

    unnamed = post("", "/api/models/U1/promote", **PROMOTION)
    assert unnamed.status_code == 400
    assert "token has not proved who it is" in unnamed.text
    proposed = post("engineer", "/api/models/U1/promote", **PROMOTION).json()["documents"][0]
    assert (proposed["kind"], proposed["identity"]) == ("ActProposed", "user:engineer-program")
    assert stage() == "off"
    path = f"/api/proposals/{proposed['uid']}"
    assert post("engineer", f"{path}/approve").status_code == 403
    assert post("", f"{path}/approve").status_code == 400  # the token is nobody by name
    assert post("operator", f"{path}/reject", reason="no reason").status_code == 403
    for refused in (post("approver", f"{path}/approve"), post("approver", f"{path}/reject", reason="no reason")):
        assert refused.status_code == 403
        assert "approver-program is a program: a person has to decide" in refused.text
    assert stage() == "off"
    with Browser(base_url=url, headers={"Accept": "text/html", "Sec-Fetch-Site": "same-origin"}, timeout=60.0,
                 follow_redirects=True) as anna:  # fmt: skip
        anna.post("/login", data={"name": "anna", "password": PASSWORD})
        page = anna.get("/proposals").text
        assert "U1, rate: version 1 of its error model live" in page
        assert "/act/approve_proposal" in page
        assert "产品 U1，rate：误差模型第 1 版启用" in anna.get("/proposals", params={"lang": "zh"}).text
        anna.get("/proposals", params={"lang": "en"})
        assert "/proposals" in anna.get("/diagnosis/U1").text
        fields = {"csrf": anna.csrf, "back": "/proposals", "path.proposal": proposed["uid"]}
        answer = anna.post("/act/approve_proposal", data=fields)
        assert answer.status_code == 200, answer.text
        assert "/act/approve_proposal" not in answer.text
        assert "approved" in anna.get("/proposals?which=all").text
        again = anna.post("/act/approve_proposal", data=fields)
        assert again.status_code == 400
        assert "approved already, by anna" in again.text
    assert stage() == "live"


@pytest.mark.long
def test_an_approver_does_not_approve_their_own(site: tuple[str, dict[str, str]]) -> None:
    url, _ = site
    with Browser(base_url=url, headers={"Accept": "text/html", "Sec-Fetch-Site": "same-origin"}, timeout=60.0,
                 follow_redirects=True) as anna:  # fmt: skip
        anna.post("/login", data={"name": "anna", "password": PASSWORD})
        anna.headers["X-CSRF-Token"] = anna.csrf
        answer = anna.post("/api/models/U1/promote", json=PROMOTION | {"stage": "shadow", "reason": "again"})
        uid = answer.json()["documents"][0]["uid"]
        own = anna.post(f"/api/proposals/{uid}/approve", json={})
        assert own.status_code == 400
        assert "another person has to approve" in own.text
        assert anna.post(f"/api/proposals/{uid}/reject", json={"reason": "too early"}).status_code == 200


@pytest.mark.long
def test_a_program_approves_nothing_and_withdraws_its_own(site: tuple[str, dict[str, str]]) -> None:
    url, tokens = site
    headers = {"Authorization": f"Bearer {tokens['approver']}"}
    with httpx.Client(base_url=url, headers=headers, timeout=60.0) as approver:
        answer = approver.post("/api/models/U1/promote", json=PROMOTION | {"stage": "shadow"})
        uid = answer.json()["documents"][0]["uid"]
        (row,) = approver.get("/api/proposals").json()["proposals"]
        assert (row["id"], row["may_approve"]) == (uid, False)
        assert "a person has to decide" in row["why_not"]
        own = approver.post(f"/api/proposals/{uid}/approve", json={})
        assert own.status_code == 403
        assert "a person has to decide" in own.text
        engineer = {"Authorization": f"Bearer {tokens['engineer']}"}
        refused = approver.post(f"/api/proposals/{uid}/reject", json={"reason": "not good"}, headers=engineer)
        assert refused.status_code == 403
        done = approver.post(f"/api/proposals/{uid}/reject", json={"reason": "too early"})
        assert done.json()["document"]["kind"] == "ProposalRejected"
        assert approver.get("/api/proposals").json()["proposals"] == []
