"""Who may enter, and what they may do there."""

import re
from collections.abc import Iterator

import httpx
import pytest

from tests.analytics.serve.conftest import Served

PROTECTED = (
    "/api/units",
    "/api/runs",
    "/api/store",
    "/api/openapi.json",
    "/api/me",
    "/api/live",
    "/api/floor",
    "/api/jobs",
)


@pytest.fixture
def vera(served: Served) -> Iterator[httpx.Client]:
    with served.browser("vera") as browser:
        yield browser


@pytest.mark.parametrize("path", PROTECTED)
@pytest.mark.parametrize("header", [None, "Bearer wrong", "Basic dmVyYTp4", "bearer"])
def test_without_a_token_there_is_no_answer(served: Served, path: str, header: str | None) -> None:
    with served.nobody(**({} if header is None else {"Authorization": header})) as client:
        answer = client.get(path)
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert "gyrofleet serve" in answer.json()["error"]["message"]


def test_statements_need_a_token_too(served: Served) -> None:
    with served.nobody() as client:
        assert client.post("/api/sql", json={"sql": "select 1"}).status_code == 401


def test_health_is_for_everybody_and_says_nothing_else(served: Served) -> None:
    with served.nobody() as client:
        assert client.get("/health").json() == {"status": "ok"}


def test_a_wrong_token_beside_a_good_cookie_is_wrong(vera: httpx.Client) -> None:
    assert vera.get("/api/me").json()["name"] == "vera"
    assert vera.get("/api/me", headers={"Authorization": "Bearer wrong"}).status_code == 401


def test_the_cookie_is_hidden_from_scripts_and_other_sites(served: Served) -> None:
    with served.nobody() as client:
        answer = client.post("/login", data={"name": "vera", "password": "correct horse battery staple"})
    words = {each.strip().lower() for each in answer.headers["set-cookie"].split(";")[1:]}
    assert {"httponly", "samesite=strict", "path=/"} <= words


@pytest.mark.parametrize(
    "fields",
    [{"name": "vera", "password": "wrong wrong wrong"}, {"name": "nobody", "password": "x" * 20}, {"token": "x"}],
)
def test_wrong_names_passwords_and_tokens_look_the_same(served: Served, fields: dict[str, str]) -> None:
    with served.nobody() as client:
        answer = client.post("/login", data=fields)
    assert answer.status_code in (403, 429)
    assert "set-cookie" not in answer.headers
    if answer.status_code == 403:
        assert "Name, password or token are wrong" in answer.text


def test_after_logout_the_cookie_is_worth_nothing(served: Served) -> None:
    with served.browser("vera") as browser:
        cookie = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
        assert browser.post("/logout", data={"csrf": browser.csrf}).url.path == "/login"
    with served.nobody(Cookie=cookie) as client:
        assert client.get("/api/me").status_code == 401


@pytest.mark.parametrize(
    ("role", "path", "body", "status"),
    [
        ("viewer", "/api/notes", {"run": "run-1", "text": "x"}, 403),
        ("viewer", "/api/store/verify", {}, 403),
        ("operator", "/api/diagnosis/FOG-0001/jobs", {"model": "rate = bias"}, 403),
        ("operator", "/api/models/FOG-0001/promote", {"version": 1, "reason": "because"}, 403),
        ("engineer", "/api/models/FOG-0001/promote", {"version": 1, "reason": "because"}, 404),
        ("viewer", "/api/sql", {"sql": "select 1"}, 200),
    ],
)
def test_each_role_may_do_its_own(served: Served, role: str, path: str, body: dict[str, object], status: int) -> None:
    with served.program(role) as client:
        answer = client.post(path, json=body)
    assert answer.status_code == status, answer.text
    if status == 403:
        assert f"{role}-program has {role}" in answer.json()["error"]["message"]


FORGED = {"X-Role": "approver", "X-Forwarded-User": "anna", "Remote-User": "anna", "X-Remote-User": "anna"}


def test_headers_and_fields_do_not_give_a_role(served: Served, vera: httpx.Client) -> None:
    with served.nobody(**FORGED) as client:
        assert client.get("/api/me").status_code == 401
    assert vera.get("/api/me", headers=FORGED, params={"role": "approver"}).json()["role"] == "viewer"
    body = {"run": "run-1", "text": "x", "role": "approver"}
    with served.program("viewer") as client:
        assert client.post("/api/notes", json=body).status_code == 403


def test_forged_cookies_are_nobody(served: Served, vera: httpx.Client) -> None:
    (name, value) = next(iter(dict(vera.cookies).items()))
    for forged in ("", "x", value[:-1], value + "x", "../../etc/passwd", "%00"):
        with served.nobody() as client:
            assert client.get("/api/me", headers={"Cookie": f"{name}={forged}"}).status_code == 401


@pytest.mark.parametrize(
    ("headers", "csrf", "status"),
    [
        ({}, None, 403),
        ({}, "wrong", 403),
        ({}, "", 200),
        ({"Origin": "https://evil.example"}, "", 403),
        ({"Origin": "null"}, "", 403),
        ({"Sec-Fetch-Site": "cross-site"}, "", 403),
        ({"Sec-Fetch-Site": "same-site"}, "", 403),
    ],
)
def test_a_browsers_change_needs_the_secret_of_its_session(
    served: Served, headers: dict[str, str], csrf: str | None, status: int
) -> None:
    with served.browser("vera") as browser:
        given = browser.csrf if csrf == "" else csrf
        sent = headers | ({} if given is None else {"X-CSRF-Token": given})
        answer = browser.post("/api/sql", json={"sql": "select 1 as one"}, headers=sent)
    assert answer.status_code == status, answer.text


def test_a_form_needs_it_too_and_then_goes_back_to_its_page(served: Served) -> None:
    with served.browser("otto") as browser:
        fields = {"run": "run-2", "text": "bench door was open", "back": "/runs/run-2"}
        assert browser.post("/act/add_note", data=fields).status_code == 403
        answer = browser.post("/act/add_note", data=fields | {"csrf": browser.csrf})
        assert (answer.status_code, answer.url.path) == (200, "/runs/run-2")
    with served.program("viewer") as client:
        notes = client.get("/api/events", params={"kind": "NoteAdded", "run": "run-2"}).json()["events"]
    authors = {each["document"]["text"]: each["document"]["author"] for each in notes}
    assert authors["bench door was open"] == "otto"


@pytest.mark.parametrize(("site", "is_shown"), [("same-origin", True), ("cross-site", False)])
def test_what_was_written_is_given_back_where_the_session_has_ended(
    served: Served, site: str, *, is_shown: bool
) -> None:
    fields = {"run": "run-2", "text": "bench <b>door</b> was open", "csrf": "old"}
    headers = {"Sec-Fetch-Site": site, "Accept": "text/html"}
    with served.browser("otto") as browser:
        refused = browser.post("/act/add_note", data=fields, headers=headers)
        browser.cookies.clear()
        ended = browser.post("/act/add_note", data=fields, headers=headers)
    assert refused.status_code == 403
    for answer in (refused, ended):
        assert ("bench &lt;b&gt;door&lt;/b&gt; was open" in answer.text) is is_shown
        assert "<b>door" not in answer.text


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "a@b", "[::1"])
def test_another_host_name_is_refused(served: Served, host: str) -> None:
    with served.program() as client:
        answer = client.get("/api/units", headers={"Host": host})
    assert answer.status_code in (400, 421)
    assert "FOG" not in answer.text


def test_every_answer_says_what_a_page_may_load(served: Served, api: httpx.Client) -> None:
    with served.nobody() as nobody:
        answers = [
            nobody.get("/login"),
            nobody.get("/api/units"),
            nobody.get("/nothing"),
            nobody.get("/static/icon.svg"),
        ]
    answers += [api.get("/units"), api.get("/api/units"), api.post("/api/sql", content=b"{")]
    for answer in answers:
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; ")
        assert "require-trusted-types-for 'script'" in policy
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "same-origin"


def test_a_page_for_nobody_leads_to_the_login_and_back(served: Served) -> None:
    with served.nobody(Accept="text/html") as client:
        answer = client.get("/units?lot=7")
        assert (answer.status_code, answer.headers["location"]) == (303, "/login?next=%2Funits%3Flot%3D7")
        # browsers leave a strict cookie out after a click on another site: the page asks once more by itself
        crossed = client.get("/units?lot=7", headers={"Sec-Fetch-Site": "cross-site"})
        assert 'content="0; url=/units?lot=7"' in crossed.text


@pytest.mark.parametrize(
    "target", ["//evil.example", "https://evil.example/", "/\\evil.example", "javascript:alert(1)"]
)
def test_a_login_leads_to_no_other_site(served: Served, target: str) -> None:
    with served.nobody() as client:
        answer = client.get("/login", params={"next": target})
    assert re.findall(r'name="next" value="([^"]*)"', answer.text) == ["/", "/"]
