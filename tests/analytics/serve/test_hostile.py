"""Names that attack, tricks with paths, and requests that are no requests: refused or shown as what they are."""

import socket
from urllib.parse import quote

import httpx
import pytest

from tests.analytics.serve.conftest import TOKEN, Served
from tests.analytics.serve.served_store import HOSTILE


@pytest.mark.long
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_is_a_name_everywhere(api: httpx.Client, name: str) -> None:
    quoted = quote(name, safe="")
    assert api.get(f"/api/units/{quoted}").json()["unit"] == name
    assert api.get(f"/api/runs/{quoted}").json()["run"]["run"] == name
    assert api.get(f"/api/signals/{quoted}/{quoted}/rate", params={"points": 10}).json()["samples"] == 50
    assert {each["run"] for each in api.get("/api/events", params={"run": name}).json()["events"]} == {name}
    assert api.get("/api/units", params={"search": name}).json()["count"] == 1


@pytest.mark.parametrize(
    "path", ["/units", "/runs", "/units/{}", "/runs/{}", "/signals/{}/{}/rate", "/diagnosis/{}", "/events?unit={}"]
)
@pytest.mark.parametrize("name", HOSTILE[:1])
def test_a_hostile_name_is_text_on_every_page(api: httpx.Client, path: str, name: str) -> None:
    answer = api.get(path.format(*[quote(name, safe="")] * 2), headers={"Accept": "text/html"})
    assert answer.status_code == 200
    assert "<svg" not in answer.text
    assert "&lt;svg-onload=alert(1)&gt;" in answer.text


def test_a_template_in_a_name_is_not_filled_in(api: httpx.Client) -> None:
    assert "{{7-7}}" in api.get("/units").text


def test_a_formula_in_a_name_is_text_in_csv(api: httpx.Client) -> None:
    lines = api.get("/api/units", params={"format": "csv"}).text.splitlines()
    assert [line.split(",")[0] for line in lines if "cmd" in line] == ["'=cmd|'calc'!A0"]


TRICKS = (
    "/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py", "/static//etc/passwd",
    "/static/%2fetc%2fpasswd", "/static/....//app.py", "/static/%00", "/static/.", "/%2e%2e/%2e%2e/etc/passwd",
    "/api/units/..%2f..%2fetc%2fpasswd", "/api/units/%00", "/api/units/%ff%fe", "/api/units/FOG-0001%00",
    "/api/runs/%2e%2e",
    "/units/%0d%0aX-Evil:1",
    "/api/signals/FOG-0001/run-1/rate%27%20or%201=1--", "/api/diagnosis/..%2fusers.toml", "/api/diagnosis/%2e%2e",
    "/api/jobs/..%2f..%2fetc", "/diagnosis/%5c..%5c..", "//evil.example/units",
)  # fmt: skip


@pytest.mark.parametrize("path", TRICKS)
def test_a_trick_with_a_path_finds_nothing(served: Served, path: str) -> None:
    status, head, body = raw(served, f"GET {path} HTTP/1.1\r\nAuthorization: Bearer {TOKEN}")
    assert status in (307, 400, 404), (status, body)
    assert "x-evil" not in head.lower()
    assert "root:" not in body
    assert "import" not in body.replace("`gyrofleet import`", "")
    assert "Traceback" not in body


@pytest.mark.parametrize(
    "request_line",
    ["G@T /api/units HTTP/1.1", "GET /api/units?limit=%00 HTTP/1.1", "GET * HTTP/1.1",
     "GET /api/units?" + "x" * 100_000 + " HTTP/1.1", "GET /api/units?limit=1&limit=2 HTTP/1.1",
     "CONNECT evil.example:80 HTTP/1.1", "GET /api/units?search=" + "a" * 500 + " HTTP/1.1"],
    ids=["method", "null", "star", "long", "twice", "connect", "search"],
)  # fmt: skip
def test_a_request_that_is_none_is_refused(served: Served, request_line: str) -> None:
    status, _, body = raw(served, f"{request_line}\r\nAuthorization: Bearer {TOKEN}")
    assert 400 <= status < 500
    assert "Traceback" not in body


def raw(served: Served, head: str) -> tuple[int, str, str]:
    """Status, head and body of the answer to a request as it is written here."""
    host, _, port = served.url.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=30) as line:
        line.sendall(f"{head}\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode("latin-1"))
        answer = b""
        try:
            while piece := line.recv(65536):
                answer += piece
        except ConnectionResetError:
            pass
    found, _, body = answer.decode("utf-8", "replace").partition("\r\n\r\n")
    return int(found.split(" ")[1]), found, body


def test_two_lengths_are_refused(served: Served) -> None:
    status, _, _ = raw(served, "POST /api/sql HTTP/1.1\r\nContent-Length: 5\r\nContent-Length: 50")
    assert status == 400


def test_a_request_of_two_lengths_smuggles_no_other(served: Served) -> None:
    """A proxy that goes by the length forwards both as one; here the second was answered."""
    second = f"GET /api/units HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {TOKEN}\r\n"
    head = (
        f"POST /api/sql HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length: 200\r\n"
        f"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n{second}"
    )
    status, _, body = raw(served, head)
    assert status == 400
    assert "send one of them" in body
    assert "HTTP/1.1" not in body
    assert "FOG" not in body


@pytest.mark.parametrize("path", ["/api/live", "/api/units"])
def test_a_web_socket_is_closed(served: Served, path: str) -> None:
    head = (
        f"GET {path} HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    )
    status, _, _ = raw(served, head.replace("\r\nUpgrade", "\r\nConnection: Upgrade\r\nUpgrade"))
    assert 400 <= status < 500
