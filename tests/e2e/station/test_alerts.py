"""Alerts to a real SMTP server and a real web server that are away, refuse, and come back, through kills."""

import json
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from email import message_from_bytes
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiosmtpd.controller import Controller

from storage.recording.client import record_documents
from storage.store import Store
from stream.events import Verdict, VerdictGiven
from stream.identity import Place
from tests.free_ports import free_endpoint

Spawn = Callable[..., subprocess.Popen[str]]


class Mailbox:
    """An SMTP server that can be switched on and off; `refuses` makes it answer 451."""

    def __init__(self) -> None:
        self.port = int(free_endpoint().rpartition(":")[2])
        self.mails: list[Any] = []
        self.refuses = 0
        self._server: Controller | None = None

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:
        if self.refuses:
            self.refuses -= 1
            return "451 try again later"
        self.mails.append(message_from_bytes(envelope.content))
        return "250 taken"

    def open(self) -> None:
        self._server = Controller(self, hostname="127.0.0.1", port=self.port)
        self._server.start()

    def close(self) -> None:
        if self._server is not None:
            self._server.stop()
            self._server = None

    def ids(self) -> Counter[str]:
        return Counter(str(mail["Message-ID"]) for mail in self.mails)


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    box = Mailbox()
    yield box
    box.close()


@pytest.fixture
def hook() -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """A web server that answers its first two posts with 500."""
    taken: list[dict[str, Any]] = []
    refusals = [500, 500]

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            if refusals:
                self.send_response(refusals.pop())
            else:
                taken.append({**body, "key": self.headers["Idempotency-Key"]})
                self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server.server_address[1], taken
    server.shutdown()
    server.server_close()
    thread.join()


def until(is_so: Callable[[], Any], timeout_s: float = 60.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (found := is_so()):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return found


def rules(folder: Path, smtp: int, http: int) -> Path:
    path = folder / "alerts.toml"
    path.write_text(
        f"""
        [targets.shift]
        kind = "email"
        host = "127.0.0.1"
        port = {smtp}
        sender = "gyrofleet@plant"
        to = ["shift@plant"]
        [targets.line]
        kind = "webhook"
        url = "http://127.0.0.1:{http}/alerts"
        [[rules]]
        kind = "verdict"
        severity = "alarm"
        [[rules]]
        kind = "unit_silent"
        silent_s = 3
        clear_after_s = 1
        """
    )
    return path


def watching(spawn: Spawn, path: Path) -> subprocess.Popen[str]:
    process = spawn("alert", "run", "--rules", path, "--json")
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "watching"
    return process


@pytest.mark.long
def test_each_alert_comes_once_through_kills_and_servers_that_are_away(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, mailbox: Mailbox,
    hook: tuple[int, list[dict[str, Any]]], tmp_path: Path,
) -> None:  # fmt: skip
    port, posted = hook
    path = rules(tmp_path, mailbox.port, port)
    record = spawn("record", "--listen", endpoint, "--json")
    assert record.stdout is not None
    record.stdout.readline()
    source = spawn("run-simulated", "--run", "n-1", "--simulate", "1", "--hours", "1", "--json")
    watch = watching(spawn, path)
    store = Store.open(tmp_path / "gyrofleet-data")
    failed = VerdictGiven(run="n-1", t_ns=time.time_ns(), unit="SIM-0001", verdict=Verdict.FAIL, checks=())
    until(lambda: gyrofleet("status", "--json").json["last_message_age_s"] is not None)
    record_documents(store, [failed], role="a test", place=Place("local", "test"))

    def listed() -> dict[str, Any]:
        return {each["rule"]: each for each in gyrofleet("alert", "list", "--all", "--json").json}

    until(lambda: "verdict" in listed())
    watch.kill()  # before any mail could be sent
    watch.communicate()
    assert mailbox.mails == []
    mailbox.refuses = 1
    mailbox.open()
    watch = watching(spawn, path)
    until(lambda: mailbox.mails and posted, timeout_s=90.0)
    source.kill()
    source.communicate()
    until(lambda: "unit_silent" in listed())
    until(lambda: len(mailbox.ids()) >= 2)
    # killed before it has written down that a mail was taken, it would send it again under the same Message-ID
    until(lambda: all(each["sent_ns"] for found in listed().values() for each in found["deliveries"]))
    watch.kill()
    watch.communicate()
    watch = watching(spawn, path)
    spawn("run-simulated", "--run", "n-1", "--simulate", "1", "--hours", "1", "--json")  # it goes on
    until(lambda: listed()["unit_silent"]["cleared_ns"])
    until(lambda: len(mailbox.ids()) >= 3 and len(posted) >= 3)
    found = listed()
    alert = found["verdict"]["id"]
    assert gyrofleet("alert", "acknowledge", alert, "--by", "Li Wei").code == 0
    until(lambda: listed()["verdict"]["acknowledged_by"] == "Li Wei")
    time.sleep(2.0)  # nothing more comes
    events = Counter((each["rule"], each["event"]) for each in posted)
    assert events == {("verdict", "raised"): 1, ("unit_silent", "raised"): 1, ("unit_silent", "cleared"): 1}
    assert set(mailbox.ids().values()) == {1}
    assert len(mailbox.ids()) == 3
    subjects = [str(mail["Subject"]) for mail in mailbox.mails]
    assert subjects[0] == "[gyrofleet alarm] raised: SIM-0001"
    text = mailbox.mails[0].get_payload(decode=True).decode()
    assert "unit SIM-0001 has FAIL in run n-1" in text
    assert "判定为FAIL" in text
    watch.terminate()
    watch.communicate(timeout=30)
    record.terminate()
    record.communicate(timeout=60)
    kinds = gyrofleet(
        "sql", "select kind, count(distinct uid)::int as n from events where kind like 'Alert%' group by 1", "--json"
    )
    counts = {each["kind"]: each["n"] for each in kinds.json}
    assert counts == {"AlertRaised": 2, "AlertSent": 6, "AlertCleared": 1, "AlertAcknowledged": 1}


@pytest.mark.parametrize(("text", "told"), [
    ('[[rules]]\nkind = "verdit"', "rule 1: kind is 'verdit'; there are "),
    ('[[rules]]\nkind = "verdict"\nto = ["nobody"]', "to names 'nobody'; the file has the targets none"),
    ('[[rules]]\nkind = "unit_silent"\nsilent_s = "long"', "rule 1 (unit_silent): Expected `float`"),
    ('[[rules]]\nkind = "disk"\n[targets.a]\nkind = "email"\nhost = "h"\nsender = "s"\nto = []\nsecurity = "ssl"',
     "security is 'ssl'; it is none, starttls or tls"),
    ('[[rules]]\nkind = "disk"\n[targets.a]\nkind = "webhook"\nurl = "file:///etc/passwd"', "it begins with https://"),
])  # fmt: skip
def test_wrong_rules_are_refused(gyrofleet: Callable[..., Any], tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "rules.toml").write_text(text)
    refused = gyrofleet("alert", "check", "--rules", "rules.toml")
    assert refused.code == 1
    assert told in refused.err


@pytest.mark.long
def test_a_change_of_level_is_told_of_the_unit_that_changes(
    gyrofleet: Callable[..., Any], spawn: Spawn, hook: tuple[int, list[dict[str, Any]]], tmp_path: Path
) -> None:
    """One record a day of two units; the bias of one of them changes on the 25th day."""
    rng = np.random.default_rng(20261207)
    lines = ["unit,run,time,rate[deg/h]"]
    for day in range(36):
        start = datetime(2026, 1, 1, 8, tzinfo=UTC) + timedelta(days=day)
        for unit, bias in (("FOG-1", 0.5), ("FOG-2", 0.9 if day >= 24 else 0.5)):
            level = bias + 0.05 * rng.standard_normal()
            lines += [
                f"{unit},day-{day:02},{(start + timedelta(seconds=at)).isoformat()},{level + 0.1 * noise:.5f}"
                for at, noise in enumerate(rng.standard_normal(60))
            ]
    (tmp_path / "days.csv").write_text("\n".join(lines))
    done = gyrofleet("import", "days.csv", "--procedure", "static_bias", "--position", "IRA_up", "--latitude", "30")
    assert done.code == 0, done.err
    port, posted = hook
    path = tmp_path / "alerts.toml"
    path.write_text(
        f"""
        [targets.line]
        kind = "webhook"
        url = "http://127.0.0.1:{port}/alerts"
        [[rules]]
        kind = "level_change"
        metric = "bias"
        """
    )
    watch = watching(spawn, path)
    try:
        (told,) = until(lambda: [*posted])
    finally:
        watch.terminate()
        watch.wait(30)
    assert told["subject"] == "FOG-2"
    assert "changes at 2026-01-25" in told["text"]
