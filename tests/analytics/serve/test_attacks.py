"""Attacks on the server as a whole: each is refused, most are reported, and nothing has changed after it."""

import re
import statistics
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote, urlencode

import httpx
import pytest

from analytics.serve.api.routes import OPERATIONS
from analytics.serve.doors.passwords import hashed, matches
from analytics.serve.pages.frame.actions import ACTIONS
from tests.analytics.serve.conftest import TOKEN, Served

CHANGES = [
    ("/api/notes", {"run": "run-1", "text": "planted"}),
    ("/api/store/verify", {}),
    ("/api/diagnosis/FOG-0001/jobs", {"model": "rate = bias"}),
    ("/api/models/FOG-0001/promote", {"version": 1, "reason": "planted"}),
    ("/api/models/FOG-0001/rollback", {"reason": "planted"}),
    ("/api/jobs/x/cancel", {}),
    ("/api/alerts/x/acknowledge", {"reason": "planted"}),
    ("/api/exclusions", {"run": "run-1", "action": "excluded", "reason": "planted"}),
    ("/api/runs/run-1/commands", {"action": "abort", "reason": "planted"}),
    ("/api/proposals/x/approve", {}),
    ("/api/proposals/x/reject", {"reason": "planted"}),
]
FORMS = ["application/json", "text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""]


@pytest.fixture(scope="module")
def anna(served: Served) -> Iterator[httpx.Client]:
    """A browser of the highest role: what is refused is not refused for its role."""
    with served.browser("anna") as browser:
        yield browser


def state(served: Served) -> tuple[Any, ...]:
    """All that a change would leave behind."""
    with served.program() as client:
        events = client.get("/api/events", params={"limit": 1000}).json()["events"]
        return len([each for each in events if "planted" in str(each)]), len(client.get("/api/jobs").json()["jobs"])


def test_every_change_of_the_api_is_attacked_here() -> None:
    of_api = {each.path for each in OPERATIONS if each.method == "POST" and not re.search("grafana|sql", each.path)}
    attacked = {path for path, _ in CHANGES}
    unknown = {re.sub(r"{\w+}", "[^/]+", path) for path in of_api}
    assert all(any(re.fullmatch(pattern, path) for path in attacked) for pattern in unknown), of_api


@pytest.mark.long
@pytest.mark.parametrize(("path", "body"), CHANGES, ids=str)
def test_no_change_without_the_secret_of_the_session(
    served: Served, anna: httpx.Client, path: str, body: dict[str, Any]
) -> None:
    before = state(served)
    for form in FORMS:
        for headers in ({}, {"X-CSRF-Token": ""}, {"X-CSRF-Token": "x" * 43}, {"X-HTTP-Method-Override": "POST"}):
            answer = anna.post(path, json=body, headers=headers | {"Content-Type": form})
            assert answer.status_code == 403, (form, headers, answer.text)
    for origin in (
        "https://evil.example",
        "null",
        served.url + ".evil.example",
        "file://",
        served.url + "@evil.example",
    ):
        secret = {"X-CSRF-Token": anna.csrf, "Origin": origin}  # type: ignore[attr-defined]
        assert anna.post(path, json=body, headers=secret).status_code == 403, origin
    two = [("X-CSRF-Token", anna.csrf), ("Origin", served.url), ("Origin", "https://evil.example")]  # type: ignore[attr-defined]
    assert anna.post(path, json=body, headers=two).status_code == 403
    read = anna.get(path, params={key: str(value) for key, value in body.items()})
    assert read.status_code in (400, 404, 405)  # 400 where it can be read too, without such parameters
    assert anna.put(path, json=body).status_code == 405
    assert state(served) == before


@pytest.mark.parametrize("action", sorted(ACTIONS))
def test_no_form_without_the_secret_of_the_session(served: Served, anna: httpx.Client, action: str) -> None:
    before = state(served)
    fields = {"run": "run-1", "text": "planted", "reason": "planted", "path.unit": "FOG-0001", "back": "/"}
    for csrf in ({}, {"csrf": ""}, {"csrf": "x" * 43}, {"X-CSRF-Token": "x"}):
        assert anna.post(f"/act/{action}", data=fields | csrf).status_code == 403
    assert anna.post(f"/act/{action}?csrf={quote(anna.csrf)}", data=fields).status_code == 403  # type: ignore[attr-defined]
    assert anna.get(f"/act/{action}?{urlencode(fields)}").status_code == 405
    assert state(served) == before


@pytest.mark.in_gate(
    "//evil.example", "/\\\\evil.example", "javascript:alert(1)", "/\\t/evil.example", "/\\r\\nSet-Cookie: a=b"
)
@pytest.mark.parametrize(
    "back", ["//evil.example", "https://evil.example", "/\\evil.example", "\\\\evil.example", "/\t/evil.example", "//[",
             "javascript:alert(1)", "/\r\nSet-Cookie: a=b", "///evil.example", "http:evil.example", " //evil.example"]
)  # fmt: skip
def test_a_form_leads_back_to_this_server_alone(served: Served, back: str) -> None:
    with served.browser("otto") as browser:
        fields = {"run": "run-1", "text": "a note", "csrf": browser.csrf, "back": back}
        answer = browser.post("/act/add_note", data=fields, follow_redirects=False)
        assert answer.status_code == 303, answer.text
        assert answer.headers["location"] == "/"
        again = browser.get("/login", params={"next": back})
        assert set(re.findall(r'name="next" value="([^"]*)"', again.text)) == {"/"}


def test_a_picture_of_another_site_uses_up_no_tries(served: Served) -> None:
    picture = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "image", "Sec-Fetch-Mode": "no-cors"}
    with served.nobody(**picture) as client:
        answers = [client.get("/login", params={"token": "wrong"}) for _ in range(20)]
    assert {each.status_code for each in answers} == {403}
    assert not any("login failed" in each.text or "too many" in each.text for each in answers)


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "127.0.0.1.nip.io", "0x7f.1", "2130706433"])
def test_a_name_that_points_here_is_no_name_of_this_server(served: Served, anna: httpx.Client, host: str) -> None:
    before = state(served)
    for method, path in (("GET", "/api/units"), ("POST", "/login"), ("POST", "/api/notes"), ("GET", "/metrics")):
        answer = anna.request(method, path, headers={"Host": host, "Origin": f"http://{host}"})
        assert answer.status_code == 421, (method, path)
        assert "FOG" not in answer.text
        assert "set-cookie" not in answer.headers
    assert state(served) == before


PRIVATE = ("/", "/units", "/units/FOG-0001", "/events", "/sql", "/api/units", "/api/me", "/api/events", "/api/store",
           "/api/units?format=csv", "/login", "/api/nothing")  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("path", PRIVATE)
def test_no_cache_on_the_way_keeps_a_private_answer(anna: httpx.Client, path: str) -> None:
    control = anna.get(path).headers["cache-control"]
    assert control == "no-store" or {"private", "no-cache"} <= {each.strip() for each in control.split(",")}


FORMULAS = ("=cmd|' /C calc'!A0", "+1+1", "-2+3+cmd", "@SUM(1)", "\t=1", "\r=1", "\n=1", "＝1+1", "＋1", "－1+1", "＠x")


def test_no_cell_or_name_of_a_column_is_a_formula(api: httpx.Client) -> None:
    body = {"sql": "select $1 as a", "format": "csv"}
    for formula in FORMULAS:
        answer = api.post("/api/sql", json=body | {"parameters": [formula]})
        assert answer.content.decode().split("\r\n", 1)[1].lstrip('"').startswith("'"), formula
    names = api.post("/api/sql", json={"sql": "select 1 as \"=cmd|' /C calc'!A0\"", "format": "csv"})
    assert names.text.lstrip('"').startswith("'=cmd")
    # numbers stay numbers
    assert api.post("/api/sql", json=body | {"parameters": ["-0.5"]}).text.split() == ["a", "-0.5"]


@pytest.mark.long
def test_an_unknown_user_takes_as_long_as_a_known_one() -> None:
    stored = hashed("correct horse battery")

    def seconds(given: str | None) -> float:
        began_s = time.process_time()
        assert not matches("wrong horse battery", given)
        return time.process_time() - began_s

    known, unknown = zip(*((seconds(stored), seconds(None)) for _ in range(3)), strict=True)
    assert statistics.median(unknown) == pytest.approx(statistics.median(known), rel=0.5)
    assert statistics.median(unknown) > 0.02


def test_cookies_of_any_kind_are_nobody(served: Served) -> None:
    with served.browser("vera") as browser:
        name, value = next(iter(dict(browser.cookies).items()))
    forged = [
        f"{name}=; {name}=", f"{name}={'A' * 43}", f"{name}={'x' * 30_000}", f'{name}="{value[::-1]}"',
        f"{name}={value.swapcase()}", f"{name}_oidc={value}", f"__Host-{name}={value}", f"{name}={value}%00",
    ]  # fmt: skip
    with served.nobody() as client:
        for cookie in forged:
            assert client.get("/api/me", headers={"Cookie": cookie}).status_code == 401, cookie[:60]


def test_names_of_a_megabyte_are_refused_at_every_door(served: Served, api: httpx.Client) -> None:
    name = "N" * (1 << 20)
    assert api.post("/api/notes", json={"run": name, "text": "x"}).status_code in (400, 404, 413)
    assert api.post("/api/notes", json={"run": name[:500_000], "text": "x"}).status_code in (400, 404)
    assert api.get("/api/units", params={"search": name[:50_000]}).status_code == 400
    with served.nobody() as client:
        answer = client.post("/login", data={"name": name[:500_000], "password": name[:500_000]})
        assert answer.status_code in (403, 413, 429)
        assert len(answer.text) < 10_000


@pytest.mark.parametrize(
    "token", [TOKEN[:-1], TOKEN + " x", TOKEN.lower(), "é" * 40, f"{TOKEN},{TOKEN}", "*", "x" * 20_000]
)
def test_tokens_that_are_none(served: Served, token: str) -> None:
    with served.nobody() as client:
        given = [(b"Authorization", b"Bearer " + token.encode("latin-1"))]
        assert client.get("/api/me", headers=given).status_code == 401
