"""Login by a provider of OpenID Connect: a real provider beside a real server, and what each of its lies leads to."""

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from tests.analytics.serve import oidc_provider
from tests.analytics.serve.conftest import start, write_users
from tests.forked_commands import CommandServer

HERE = Path(__file__).parent
LOGIN = f"""
[oidc]
issuer = "{{issuer}}"
client_id = "{oidc_provider.CLIENT}"
client_secret_file = "oidc-secret"
session_h = 0.5

[oidc.roles]
"gyro engineers" = "engineer"
"gyro viewers" = "viewer"
"""


class Pair(NamedTuple):
    """A server, its provider, and the file with what the server reports."""

    url: str
    provider: str
    log: Path
    folder: Path

    def lie(self, **lies: Any) -> None:
        httpx.post(f"{self.provider}/lie", json=lies).raise_for_status()

    def browser(self, **headers: str) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers={"Accept": "text/html"} | headers, timeout=30)

    def reported(self, text: str) -> bool:
        return text in self.log.read_text()


@pytest.fixture(scope="module")
def pair(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[Pair]:
    folder = tmp_path_factory.mktemp("oidc")
    (folder / "a.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{i},{i % 5}\n" for i in range(100)))
    assert run_command("import", "a.csv", "--unit", "G-1", "--store", "S", cwd=folder).code == 0
    write_users(folder / "users.toml")
    log = folder / "log"
    with ExitStack() as ends, log.open("w") as file:
        provider = subprocess.Popen(
            [sys.executable, "-P", str(HERE / "oidc_provider.py")], stdout=subprocess.PIPE, text=True
        )
        ends.callback(_ended, provider)
        assert provider.stdout is not None
        issuer = provider.stdout.readline().strip()
        (folder / "login.toml").write_text(LOGIN.format(issuer=issuer))
        (folder / "oidc-secret").write_text(f"{oidc_provider.SECRET}\n")
        process, ready = start(
            command_server, "--store", "S", "--port", 0, "--login", "login.toml", "--users", "users.toml", cwd=folder,
            stderr=file,
        )  # fmt: skip
        ends.callback(_ended, process)
        yield Pair(ready["url"], issuer, log, folder)
    assert process.returncode == 0
    assert "Traceback" not in log.read_text()


def _ended(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.communicate(timeout=20)


@pytest.fixture(autouse=True)
def honest(pair: Pair) -> None:
    pair.lie()


def answer_of(browser: httpx.Client, target: str = "/units") -> str:
    """Begin a login and log in at the provider; the address that the provider sends the browser back to."""
    begun = browser.get("/login/oidc", params={"next": target})
    assert begun.status_code == 303, begun.text
    back = httpx.get(begun.headers["location"])
    assert back.status_code == 302, back.text
    return str(back.headers["location"])


def refused(pair: Pair, sentence: str, **lies: Any) -> str:
    """Log in while the provider lies: nobody has entered, the page says why, the log as well."""
    pair.lie(**lies)
    before = pair.log.read_text().count("login refused")
    with pair.browser() as browser:
        answer = browser.get(answer_of(browser))
        assert answer.status_code == 403, answer.text
        assert sentence in answer.text
        assert "set-cookie" not in answer.headers
        assert browser.get("/api/me").status_code == 401
    assert pair.log.read_text().count("login refused") == before + 1
    return pair.log.read_text().splitlines()[-1]


NOT_HELD = "The login service&#39;s answer does not hold"


def test_a_login_gives_the_role_of_the_group_and_leads_to_the_page(pair: Pair) -> None:
    with pair.browser() as browser:
        assert "/login/oidc?next=%2Funits" in browser.get("/login?next=/units").text
        answer = browser.get(answer_of(browser))
        assert (answer.status_code, re.findall(r"url=([^\"]+)\"", answer.text)) == (200, ["/units"])
        assert 0 < len(answer.headers.get_list("set-cookie")) <= 2
        me = browser.get("/api/me").json()
        assert (me["name"], me["role"]) == ("wang.li", "engineer")
        assert browser.get("/units").status_code == 200
        # a change needs the secret of the session, as for everybody
        assert browser.post("/api/notes", json={"run": "x", "text": "y"}).status_code == 403
    assert pair.reported("login from 127.0.0.1: wang.li by OIDC, subject '8f1e', engineer")


def test_what_is_asked_of_the_provider(pair: Pair) -> None:
    with pair.browser() as browser:
        begun = browser.get("/login/oidc")
    asked = {name: values[0] for name, values in parse_qs(urlsplit(begun.headers["location"]).query).items()}
    assert asked["redirect_uri"] == f"{pair.url}/login/oidc/done"
    assert (asked["response_type"], asked["code_challenge_method"]) == ("code", "S256")
    assert min(len(asked[name]) for name in ("state", "nonce", "code_challenge")) >= 43
    words = {each.strip().lower() for each in begun.headers["set-cookie"].split(";")}
    assert {"httponly", "samesite=lax", "max-age=600"} <= words
    assert oidc_provider.SECRET not in begun.headers["location"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("lies", "said"),
    [
        ({"claims": {"nonce": "another"}}, "nonce"),
        ({"claims": {"nonce": None}}, "nonce"),
        ({"claims": {"aud": "another"}}, "aud"),
        ({"claims": {"aud": ["another", "third"]}}, "aud"),
        ({"claims": {"aud": [oidc_provider.CLIENT, "another"]}}, "azp"),
        ({"claims": {"azp": "another"}}, "azp"),
        ({"claims": {"iss": "http://127.0.0.1:1"}}, "iss"),
        ({"claims": {"sub": None}}, "sub"),
        ({"claims": {"exp": None}}, "exp"),
        ({"claims": {"exp": "tomorrow"}}, "exp"),
        ({"moved_s": {"exp": -60}}, "expired"),
        ({"moved_s": {"iat": 600}}, "issued in the future"),
        ({"moved_s": {"nbf": 600}}, "not yet valid"),
        ({"signed": "none"}, "not signed"),
        ({"signed": "hmac of the secret"}, "not signed"),
        ({"signed": "hmac of the public key"}, "not signed"),
        ({"signed": "forged"}, "not signed"),
        ({"signed": "new"}, "not signed"),
        ({"changed": {"groups": ["gyro engineers"], "preferred_username": "boss"}}, "not signed"),
        ({"answer_issuer": "https://evil.example"}, "of the issuer 'https://evil.example'"),
    ],
    ids=str,
)
def test_a_token_that_does_not_hold_is_refused(pair: Pair, lies: dict[str, Any], said: str) -> None:
    assert said in refused(pair, NOT_HELD, **lies)


@pytest.mark.parametrize("clock_s", [-7200, 7200])
def test_a_clock_that_is_off_is_named(pair: Pair, clock_s: int) -> None:
    line = refused(pair, "The clock of this server differs by 7", clock_s=clock_s)
    assert ("ahead of" if clock_s < 0 else "behind") in line
    with pair.browser(**{"Accept-Language": "zh-CN"}) as browser:
        assert "请联系服务器管理员校准时钟" in browser.get(answer_of(browser)).text


@pytest.mark.parametrize("groups", [None, [], ["canteen"], "canteen", [["gyro engineers"]], {"gyro engineers": 1}, 7])
def test_without_a_role_nobody_enters(pair: Pair, groups: Any) -> None:
    assert "wang.li" in refused(pair, "none of your groups has a role here", claims={"groups": groups})
    with pair.browser(**{"Accept-Language": "zh"}) as browser:
        assert "在此处没有角色" in browser.get(answer_of(browser)).text


@pytest.mark.parametrize("name", [None, "", "a b", "<b>", "x" * 65, 7, "token", "anna"])
def test_a_name_that_is_none_or_another_users_is_refused(pair: Pair, name: Any) -> None:
    refused(pair, "a name that cannot be used here", claims={"preferred_username": name})


def test_of_several_groups_the_highest_role_counts(pair: Pair) -> None:
    pair.lie(claims={"groups": ["gyro viewers", "gyro engineers"]})
    with pair.browser() as browser:
        browser.get(answer_of(browser))
        assert browser.get("/api/me").json()["role"] == "engineer"


def test_what_a_person_writes_in_the_address_gives_no_role(pair: Pair) -> None:
    pair.lie(claims={"groups": ["gyro viewers"]})
    with pair.browser() as browser:
        browser.get(answer_of(browser) + "&groups=gyro+engineers&role=approver")
        assert browser.get("/api/me").json()["role"] == "viewer"


def test_a_forged_state_and_a_state_of_another_browser_are_refused(pair: Pair) -> None:
    with pair.browser() as browser, pair.browser() as other:
        address = answer_of(browser)
        forged = re.sub(r"state=[^&]+", "state=" + "A" * 43, address)
        answers = [browser.get(forged), browser.get(re.sub(r"state=[^&]+&?", "", address)), other.get(address)]
        assert [each.status_code for each in answers] == [403, 403, 403]
        assert all("This login began in another browser" in each.text for each in answers)
        # the other browser has used it up
        assert browser.get(address).status_code == 403
        assert browser.get("/api/me").status_code == other.get("/api/me").status_code == 401
    assert pair.reported("the login began in another browser")


def test_an_answer_and_a_code_count_once(pair: Pair) -> None:
    with pair.browser() as browser:
        address = answer_of(browser)
        assert browser.get(address).status_code == 200
        assert browser.get(address).status_code == 403
    with pair.browser() as browser:  # the code of the first login in a second one
        code = parse_qs(urlsplit(address).query)["code"][0]
        again = browser.get(re.sub(r"code=[^&]+", f"code={code}", answer_of(browser)))
        assert (again.status_code, NOT_HELD in again.text) == (403, True)
    assert pair.reported("the provider refuses the code: invalid_grant")


def test_a_code_of_another_login_does_not_fit(pair: Pair) -> None:
    with pair.browser() as thief, pair.browser() as victim:
        stolen = parse_qs(urlsplit(answer_of(victim)).query)["code"][0]
        answer = thief.get(re.sub(r"code=[^&]+", f"code={stolen}", answer_of(thief)))
        assert answer.status_code == 403
        assert thief.get("/api/me").status_code == 401


def test_a_provider_that_refuses_is_quoted_by_nobody(pair: Pair) -> None:
    line = refused(pair, "did not let you in, or you went back", error="access_denied")
    assert "access_denied" in line
    with pair.browser() as browser:
        assert "alert(1)" not in browser.get(answer_of(browser)).text


@pytest.mark.long
def test_new_keys_of_the_provider_are_fetched(pair: Pair) -> None:
    pair.lie(keys="new", signed="new")
    time.sleep(5.5)  # no more often than each 5 s
    with pair.browser() as browser:
        assert browser.get(answer_of(browser)).status_code == 200
        assert browser.get("/api/me").status_code == 200


def test_logout_ends_the_session_and_leads_to_that_of_the_provider(pair: Pair) -> None:
    with pair.browser() as browser:
        browser.get(answer_of(browser))
        csrf = browser.get("/api/me").json()["csrf"]
        assert browser.post("/logout", data={"csrf": "x"}).status_code == 403
        answer = browser.post("/logout", data={"csrf": csrf})
        found = re.search(r"url=([^\"]+)\"", answer.text)
        assert found is not None
        url = found[1].replace("&amp;", "&")
        assert httpx.get(url).text == f"logged out {pair.url}/login"
        assert url.startswith(f"{pair.provider}/logout?id_token_hint=ey")
        assert browser.get("/api/me").status_code == 401


@pytest.mark.parametrize(
    "target", ["//evil.example", "https://evil.example/", "/\\evil.example", "javascript:alert(1)"]
)
def test_a_login_leads_to_no_other_site(pair: Pair, target: str) -> None:
    with pair.browser() as browser:
        answer = browser.get(answer_of(browser, target))
    assert re.findall(r"url=([^\"]+)\"", answer.text) == ["/"]


def test_another_name_of_the_host_leads_to_the_one_that_the_provider_knows(pair: Pair) -> None:
    other = pair.url.replace("127.0.0.1", "localhost")
    with httpx.Client(base_url=other) as browser:
        answer = browser.get("/login/oidc", params={"next": "/units"})
    assert answer.headers["location"].startswith(f"{pair.url}/login/oidc?")
    assert "set-cookie" not in answer.headers


@pytest.mark.long
@pytest.mark.parametrize(
    ("issuer", "said"),
    [("http://127.0.0.1:9", "Connection refused"), ("{provider}/other", "answers 404"),
     ("{provider}/", "is of the issuer")],
    ids=["nobody", "another", "slash"],
)  # fmt: skip
def test_a_provider_that_is_not_there_is_named(
    pair: Pair, tmp_path: Path, command_server: CommandServer, issuer: str, said: str
) -> None:
    (tmp_path / "login.toml").write_text(LOGIN.format(issuer=issuer.format(provider=pair.provider)))
    (tmp_path / "oidc-secret").write_text(oidc_provider.SECRET)
    process, ready = start(
        command_server, "--store", pair.folder / "S", "--port", 0, "--login", tmp_path / "login.toml", cwd=tmp_path
    )
    with httpx.Client(base_url=ready["url"]) as browser:
        answer = browser.get("/login/oidc")
        assert (answer.status_code, "cannot be reached now" in answer.text) == (503, True)
        answer = browser.get("/login/oidc?lang=zh")
        assert (answer.status_code, "目前无法连接登录服务" in answer.text) == (503, True)
    process.terminate()
    _, err = process.communicate(timeout=20)
    assert process.returncode == 0
    assert said in err
