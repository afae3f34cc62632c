"""Client certificates through a proxy that ends TLS: whom they let in, and what headers from elsewhere are worth."""

import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from tests.analytics.serve.conftest import PASSWORD, start, write_users
from tests.analytics.serve.tls_proxy import Authority, tls_proxy
from tests.forked_commands import CommandServer

SECRET = "s" * 40
OIDC = '[oidc]\nissuer = "https://login.plant"\nclient_id = "g"\n[oidc.roles]\na = "viewer"\n'
LOGIN = '[proxy]\naddresses = ["127.0.0.1"]\nsecret_file = "proxy-secret"\n'
WANG = "CN=王丽,O=Plant"


class Site(NamedTuple):
    """A server, the proxy before it, certificates, and the file with what the server reports."""

    url: str
    proxied: str
    plant: Authority
    stranger: Authority
    log: Path

    def holder(self, name: str, organization: str = "Plant", authority: Authority | None = None) -> httpx.Client:
        return self.client((authority or self.plant).issue(name, organization))

    def client(self, certificate: Path | None) -> httpx.Client:
        context = ssl.create_default_context(cafile=str(self.plant.path))
        if certificate is not None:
            context.load_cert_chain(certificate)
        return httpx.Client(base_url=self.proxied, verify=context, timeout=30)

    def direct(self, *headers: tuple[str, str]) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers=list(headers), timeout=30)


@pytest.fixture(scope="module")
def site(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "a.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{i},{i % 5}\n" for i in range(100)))
    assert run_command("import", "a.csv", "--unit", "G-1", "--run", "r", "--store", "S", cwd=folder).code == 0
    write_users(folder / "users.toml")
    for name, role, subject in (("wang", "operator", WANG), ("robot", "viewer", "CN=robot,O=Plant")):
        words = ("users", "add", name, "--role", role, "--certificate", subject, "--users", "users.toml")
        assert run_command(*words, cwd=folder).code == 0
    (folder / "login.toml").write_text(LOGIN)
    (folder / "proxy-secret").write_text(SECRET)
    plant, stranger, log = Authority(folder, "plant"), Authority(folder, "stranger"), folder / "log"
    with log.open("w") as file:
        process, ready = start(
            command_server, "--store", "S", "--port", 0, "--login", "login.toml", "--users", "users.toml", "--url",
            "https://localhost", cwd=folder, stderr=file,
        )  # fmt: skip
        try:
            with tls_proxy(ready["url"], plant.issue("localhost"), plant.path, SECRET) as proxied:
                yield Site(ready["url"], proxied, plant, stranger, log)
        finally:
            process.terminate()
            process.communicate(timeout=20)
    assert "Traceback" not in log.read_text()


def test_a_certificate_is_the_user_with_its_subject(site: Site) -> None:
    with site.holder("王丽") as wang, site.holder("robot") as robot:
        me = wang.get("/api/me").json()
        assert (me["name"], me["role"]) == ("wang", "operator")
        assert robot.get("/api/me").json()["role"] == "viewer"
        assert "wang" in wang.get("/units", headers={"Accept": "text/html"}).text


def test_without_a_certificate_of_the_plant_there_is_no_connection(site: Site) -> None:
    with site.client(None) as nobody, pytest.raises(httpx.TransportError):
        nobody.get("/api/me")
    with site.holder("王丽", authority=site.stranger) as forged, pytest.raises(httpx.TransportError):
        forged.get("/api/me")


@pytest.mark.parametrize(("name", "organization"), [("anna", "Plant"), ("王丽", "Plant2"), ("王丽,O=Plant", "x")])
def test_a_certificate_of_nobody_is_refused_and_reported(site: Site, name: str, organization: str) -> None:
    with site.holder(name, organization) as other:
        answer = other.get("/api/me")
        assert (answer.status_code, "is of no user" in answer.text) == (403, True)
        assert other.get("/login").status_code == 403
    assert "refused from 10.1.2.3: GET /api/me as nobody: the certificate" in site.log.read_text()


def test_a_change_needs_a_secret_that_no_other_site_knows(site: Site) -> None:
    body = {"run": "r", "text": "bench door open"}
    with site.holder("王丽") as wang, site.holder("robot") as robot:
        assert wang.post("/api/notes", json=body).status_code == 403
        secret = {"X-CSRF-Token": wang.get("/api/me").json()["csrf"]}
        assert (
            wang.post("/api/notes", json=body, headers=secret | {"Origin": "https://evil.example"}).status_code == 403
        )
        # a page without TLS is another site
        plain = site.proxied.replace("https", "http")
        assert wang.post("/api/notes", json=body, headers=secret | {"Origin": plain}).status_code == 403
        assert wang.post("/api/notes", json=body, headers=secret | {"Origin": site.proxied}).status_code == 200
        # each has their own
        assert robot.post("/api/sql", json={"sql": "select 1"}, headers=secret).status_code == 403
        notes = wang.get("/api/events", params={"kind": "NoteAdded"}).json()["events"]
        assert [each["document"]["author"] for each in notes if each["document"]["text"] == body["text"]] == ["wang"]


SUBJECT = ("X-Client-Subject", WANG.encode().decode("latin-1"))


@pytest.mark.parametrize(
    "headers",
    [
        (SUBJECT,),
        (SUBJECT, ("X-Proxy-Secret", "")),
        (SUBJECT, ("X-Proxy-Secret", "t" * 40)),
        (SUBJECT, ("X-Proxy-Secret", SECRET[:-1])),
        (SUBJECT, ("X-Proxy-Secret", SECRET), ("X-Proxy-Secret", SECRET)),
        (SUBJECT, SUBJECT, ("X-Proxy-Secret", SECRET)),
        (("X-Client-Subject", "CN=robot,O=Plant"), SUBJECT, ("X-Proxy-Secret", SECRET)),
        (SUBJECT, ("X-Proxy-Secret", "é" * 40)),
    ],
)  # fmt: skip
def test_headers_of_the_proxy_from_elsewhere_are_ignored_and_reported(
    site: Site, headers: tuple[tuple[str, str], ...]
) -> None:
    before = site.log.read_text().count("header ignored from 127.0.0.1")
    encoded = [(name.encode(), value.encode("latin-1")) for name, value in headers]
    with httpx.Client(base_url=site.url, headers=encoded) as forger:
        assert forger.get("/api/me").status_code == 401
    assert site.log.read_text().count("header ignored from 127.0.0.1") == before + 1
    assert SECRET not in site.log.read_text()


@pytest.mark.long
def test_of_another_address_the_secret_is_worth_nothing(
    tmp_path: Path, command_server: CommandServer, run_command: Callable[..., Any]
) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n0,1\n1,2\n")
    assert run_command("import", "a.csv", "--unit", "G-1", "--store", "S", cwd=tmp_path).code == 0
    (tmp_path / "login.toml").write_text(LOGIN.replace("127.0.0.1", "127.0.0.2"))
    (tmp_path / "proxy-secret").write_text(SECRET)
    words = ("users", "add", "robot", "--role", "viewer", "--certificate", "CN=robot", "--users", "users.toml")
    assert run_command(*words, cwd=tmp_path).code == 0
    process, ready = start(
        command_server, "--store", "S", "--port", 0, "--login", "login.toml", "--users", "users.toml", cwd=tmp_path
    )
    headers = {"X-Client-Subject": "CN=robot", "X-Proxy-Secret": SECRET}
    with httpx.Client(base_url=ready["url"], headers=headers) as elsewhere:
        assert elsewhere.get("/api/me").status_code == 401
    with httpx.Client(
        base_url=ready["url"], headers=headers, transport=httpx.HTTPTransport(local_address="127.0.0.2")
    ) as proxy:
        assert proxy.get("/api/me").json()["name"] == "robot"
    process.terminate()
    _, err = process.communicate(timeout=20)
    assert "header ignored from 127.0.0.1: headers of the proxy come from 127.0.0.1, which is not its address" in err


def test_behind_tls_cookies_are_secure(site: Site) -> None:
    with site.direct() as client:
        answer = client.post("/login", data={"name": "vera", "password": PASSWORD})
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith("__Host-")
    assert "Secure" in [each.strip() for each in cookie.split(";")]


def test_clients_behind_the_proxy_wait_for_their_own_wrong_passwords(site: Site) -> None:
    """One client's tries must not lock out others; what a client writes before the proxy's word counts for nothing."""

    def tries(address: str) -> list[int]:
        headers = [("X-Proxy-Secret", SECRET), ("X-Forwarded-For", address)]
        with site.direct(*headers) as client:
            return [client.post("/login", data={"token": "x"}).status_code for _ in range(12)]

    assert tries("10.0.0.1")[-1] == 429
    assert tries("10.0.0.2")[0] == 403
    assert set(tries("10.0.0.77, 10.0.0.1")) == {429}


@pytest.mark.long
@pytest.mark.parametrize(
    ("login", "secret", "said"),
    [
        (LOGIN, "short", "32 of ASCII"),
        (LOGIN, "two\nlines" * 8, "more than one line"),
        (LOGIN.replace("127.0.0.1", "proxy"), SECRET, "'proxy' is not the address"),
        (LOGIN + 'client_header = "X-Proxy-Secret"', SECRET, "two headers of the proxy have one name"),
        (LOGIN + 'subject_header = "X Y"', SECRET, "subject_header"),
        ("[proxy]\naddresses = []\nsecret_file='proxy-secret'", SECRET, "addresses"),
        (OIDC.replace("https", "http"), SECRET, "not an address with https"),
        (OIDC.replace('a = "viewer"', ""), SECRET, "nobody could enter"),
        (OIDC.replace("viewer", "boss"), SECRET, "oidc.roles"),
        (OIDC.replace("[oidc]", "[oidc]\nsession_h = 13"), SECRET, "session_h"),
        (OIDC.replace("[oidc]", '[oidc]\nclient_secret_file = "no"'), SECRET, "no cannot be read"),
        ("[odic]", SECRET, "odic"),
    ],
)  # fmt: skip
def test_a_file_of_logins_that_is_not_right_is_refused(
    tmp_path: Path, run_command: Callable[..., Any], login: str, secret: str, said: str
) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n0,1\n1,2\n")
    assert run_command("import", "a.csv", "--unit", "G-1", "--store", "S", cwd=tmp_path).code == 0
    (tmp_path / "login.toml").write_text(login)
    (tmp_path / "proxy-secret").write_text(secret)
    done = run_command("serve", "--store", "S", "--port", 0, "--login", "login.toml", "--json", cwd=tmp_path)
    assert done.code == 2, done.out
    assert said in done.json["error"]["message"]
