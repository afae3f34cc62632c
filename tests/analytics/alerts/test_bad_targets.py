"""Mail servers and web servers that answer nonsense, stall, drip and refuse in part: each alert comes once."""

import re
import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from email import message_from_bytes, policy
from pathlib import Path
from typing import Any

import msgspec
import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import SMTP

from analytics.alerts.email_target import EmailTarget
from analytics.alerts.targets import Message
from analytics.alerts.webhook_target import WebhookTarget
from analytics.loop.bilingual import Bilingual
from stream.events import AlertCleared
from tests.analytics.alerts.targets import LineServer, book_with, finding, read_post, sender, until
from tests.free_ports import free_endpoint

HOSTILE = "SIM-1\r\nBcc: all@plant.example\r\n\r\n<script>alert(1)</script>\x00\u202e" + "長" * 5_000


def hook(port: int) -> WebhookTarget:
    return WebhookTarget(url=f"http://127.0.0.1:{port}/alerts")


NONSENSE = (
    b"", b"nonsense\r\n\r\n", b"HTTP/1.1 999\r\n\r\n", b"HTTP/1.1 200 OK\r\n" + b"x" * 70_000,
    b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * 200 + b"\r\n", b"\x16\x03\x01\x00",
)  # fmt: skip


def test_nonsense_is_no_answer_and_ends_no_sender(tmp_path: Path) -> None:
    """`BadStatusLine` is no OSError: one such answer ended the thread that sends, and all later alerts were lost."""
    taken: list[bytes] = []

    def talk(line: socket.socket, number: int) -> None:
        taken.append(read_post(line))
        line.sendall(NONSENSE[number - 1] if number <= len(NONSENSE) else b"HTTP/1.1 204 No Content\r\n\r\n")

    server = LineServer(talk)
    said: list[str] = []
    with ExitStack() as stack:
        books = [stack.enter_context(book_with(tmp_path / str(at), finding(str(at)))) for at in range(len(NONSENSE))]
        threads = [stack.enter_context(sender(book, hook(server.port), said)) for book in books]
        until(lambda: not any(book.waiting() for book in books))
        assert all(thread.is_alive for thread in threads)
    server.close()
    keys = Counter(re.findall(rb"Idempotency-[Kk]ey: (\S+)", b"".join(taken)))
    assert set(keys.values()) == {2}  # the same identity each time
    assert all("does not take alert" in each or "takes alerts again" in each for each in said)
    assert len(said) == 2 * len(NONSENSE)


@pytest.mark.long
def test_a_server_that_drips_keeps_nobody_for_ever(tmp_path: Path) -> None:
    def talk(line: socket.socket, number: int) -> None:
        read_post(line)
        if number == 1:
            for _ in range(60):  # no single read takes long
                line.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
                time.sleep(0.1)
        line.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")

    server = LineServer(talk)
    began_s = time.monotonic()
    with (
        book_with(tmp_path, finding("a")) as book,
        sender(book, hook(server.port), said := [], longest_send_s=1.0),  # type: ignore[var-annotated]
    ):
        until(lambda: not book.waiting())
    assert time.monotonic() - began_s < 5.0
    assert "has not answered within the time" in said[0]
    server.close()


@pytest.mark.long
def test_a_stalled_mail_server_does_not_hold_the_end(tmp_path: Path) -> None:
    server = LineServer(lambda line, _: time.sleep(20))
    target = EmailTarget(host="127.0.0.1", port=server.port, sender="a@b", to=("c@d",))
    with book_with(tmp_path, finding("a")) as book:
        thread = sender(book, target, [])
        until(lambda: server.connections)
        began_s = time.monotonic()
        thread.close()
        assert time.monotonic() - began_s < 8.0
        assert book.waiting() == {"shift": 1}


class Box:
    """A mail server; `refused` are addresses that it refuses so often."""

    def __init__(self, quit_code: str = "221 bye") -> None:
        self.port = int(free_endpoint().rpartition(":")[2])
        self.mails: list[tuple[tuple[str, ...], Any]] = []
        self.refused: Counter[str] = Counter()
        box, answer = self, quit_code

        class Protocol(SMTP):
            async def smtp_QUIT(self, _arg: str) -> None:
                await self.push(answer)
                if self.transport is not None:
                    self.transport.close()

        class Server(Controller):
            def factory(self) -> SMTP:
                return Protocol(box, enable_SMTPUTF8=True)

        self._server = Server(self, hostname="127.0.0.1", port=self.port)
        self._server.start()

    async def handle_RCPT(self, _server: Any, _session: Any, envelope: Any, address: str, _options: Any) -> str:
        if self.refused[address] > 0:
            self.refused[address] -= 1
            return "450 greylisted"
        envelope.rcpt_tos.append(address)
        return "250 ok"

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:
        mail = message_from_bytes(envelope.content, policy=policy.default)
        self.mails.append((tuple(envelope.rcpt_tos), mail))
        return "250 taken"

    def target(self, *to: str) -> EmailTarget:
        return EmailTarget(host="127.0.0.1", port=self.port, sender="g@plant", to=to or ("shift@plant",))

    def close(self) -> None:
        with suppress(Exception):
            self._server.stop()


@pytest.fixture
def box() -> Iterator[Box]:
    made = Box()
    yield made
    made.close()


@pytest.mark.long
@pytest.mark.parametrize("code", ["250 no such thing", "500 what", "421 gone"])
def test_a_mail_that_is_taken_is_taken_however_the_line_ends(tmp_path: Path, code: str) -> None:
    """A QUIT that was answered otherwise made a failure of a mail that was taken: it was sent again for ever."""
    box = Box(code)
    with book_with(tmp_path, finding("a")) as book, sender(book, box.target(), []):
        until(lambda: not book.waiting())
        time.sleep(1.0)
    box.close()
    assert len(box.mails) == 1


def test_who_is_refused_gets_it_later_and_nobody_twice(tmp_path: Path, box: Box) -> None:
    """Of two addresses one was refused: its alert was lost, and nobody said so."""
    box.refused["boss@plant"] = 1
    said: list[str] = []
    with book_with(tmp_path, finding("a")) as book, sender(book, box.target("shift@plant", "boss@plant"), said):
        until(lambda: not book.waiting())
    assert [to for to, _ in box.mails] == [("shift@plant",), ("boss@plant",)]
    assert {str(mail["Message-ID"]) for _, mail in box.mails} == {str(box.mails[0][1]["Message-ID"])}
    assert "refuses boss@plant: 450 greylisted" in said[0]


def test_hostile_texts_are_texts(tmp_path: Path, box: Box) -> None:
    with book_with(tmp_path, finding("a", HOSTILE)) as book, sender(book, box.target(), []):
        until(lambda: not book.waiting())
    ((to, mail),) = box.mails
    assert to == ("shift@plant",)
    assert mail["Bcc"] is None
    assert mail.get_content_type() == "text/plain"
    assert re.match(r"\[gyrofleet alarm\] raised: SIM-1 Bcc: all@plant.example <script>", str(mail["Subject"]))
    assert len(str(mail["Subject"])) < 300
    body = mail.get_content()
    assert len(body) < 20_000
    assert not re.search("[\x00\u202e]", body + str(mail["Subject"]))


def test_hostile_texts_reach_a_webhook_as_json(tmp_path: Path) -> None:
    taken: list[bytes] = []

    def talk(line: socket.socket, _: int) -> None:
        taken.append(read_post(line))
        line.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")

    server = LineServer(talk)
    with book_with(tmp_path, finding("a", HOSTILE)) as book, sender(book, hook(server.port), []):
        until(lambda: not book.waiting())
    server.close()
    assert b"\r\nBcc" not in taken[0].split(b"\r\n\r\n")[0]
    assert msgspec.json.decode(taken[0].split(b"\r\n\r\n", 1)[1])["subject"] == HOSTILE


@pytest.mark.long
def test_ten_thousand_at_once_come_in_some_mails_each_named_once(tmp_path: Path, box: Box) -> None:
    many = [finding(f"key {number}", f"SIM-{number:05}") for number in range(10_000)]
    began_s = time.monotonic()
    with book_with(tmp_path, *many) as book, sender(book, box.target(), []):
        until(lambda: not book.waiting(), timeout_s=120.0)
        assert len(book.to_log(100_000)) == 20_000  # raised and sent
    assert time.monotonic() - began_s < 60.0
    named = Counter(
        name for _, mail in box.mails for name in re.findall(r"unit (SIM-\d+) has FAIL", mail.get_content())
    )
    assert len(named) == 10_000
    assert set(named.values()) == {1}
    assert len(box.mails) == 10
    assert str(box.mails[0][1]["Subject"]) == "[gyrofleet alarm] 1,000 alerts: 1,000 raised"


@pytest.mark.long
def test_cleared_comes_after_raised_also_where_raised_was_refused(tmp_path: Path, box: Box) -> None:
    box.refused["shift@plant"] = 1
    now_ns = time.time_ns()
    with book_with(tmp_path, finding("a", is_event=False)) as book:
        book.settle([], now_ns + 10**9, now_ns + 10**9)
        with sender(book, box.target(), []):
            until(lambda: not book.waiting())
    events = [str(mail["Subject"]).split("] ")[1].split(":")[0] for _, mail in box.mails]
    assert events == ["raised", "cleared"]


def test_what_ends_without_passing_is_sent_with_its_ending(tmp_path: Path, box: Box) -> None:
    now_ns = time.time_ns()
    with book_with(tmp_path, finding("a", is_event=False)) as book:
        asked = [Bilingual("the run ended while the unit was silent", "试验在该产品无记录期间结束")]
        for later in (1, 2):  # it is asked once: later the floor may no longer know
            at_ns = now_ns + later * 10**9
            book.settle([], at_ns, at_ns, ending=lambda _: asked.pop())
        with sender(book, box.target(), []):
            until(lambda: not book.waiting())
        logged = [each for each in book.to_log(10) if isinstance(each, AlertCleared)]
    assert [each.text for each in logged] == ["the run ended while the unit was silent"]
    assert [str(mail["Subject"]).split("] ")[1].split(":")[0] for _, mail in box.mails] == ["raised", "ended"]
    assert "the run ended while the unit was silent: unit" in box.mails[1][1].get_content()


@pytest.mark.long
def test_a_kill_between_two_tries_keeps_the_mail_as_it_was(tmp_path: Path, box: Box) -> None:
    box.refused["shift@plant"] = 1
    with book_with(tmp_path, *(finding(f"{number}") for number in range(5))) as book:
        thread = sender(book, box.target(), said := [])  # type: ignore[var-annotated]
        until(lambda: said)
        thread.close()
    later = [finding(f"later {number}") for number in range(2)]
    with book_with(tmp_path, *later) as book, sender(book, box.target(), []):
        until(lambda: not book.waiting())
    subjects = sorted(str(mail["Subject"]) for _, mail in box.mails)
    assert len(subjects) == 3
    assert "5 alerts: 5 raised" in subjects[0]


def test_a_mail_in_chinese_is_chinese_and_in_seven_bits() -> None:
    target = EmailTarget(host="mail.invalid", to=("a@b.invalid",), sender="g@b.invalid", lang="zh")
    message = Message(
        id="a1", event="raised", rule="不合格", severity="alarm", subject="光纤-07", text="unit 光纤-07 has FAIL",
        text_zh="产品 光纤-07 不合格", raised_ns=0, store="库一",
    )  # fmt: skip
    one, many = target._mail([message], "m1"), target._mail([message, message], "m2")
    assert (one["Subject"], many["Subject"]) == ("[gyrofleet 报警] 出现: 光纤-07", "[gyrofleet 报警] 2 条报警: 2 出现")
    for mail in (one, many):
        assert mail.as_bytes().isascii()
        body = mail.get_content()
        assert "产品 光纤-07 不合格" in body
        assert "数据库 库一" in body
        assert not {"raised", "rule", "store", "FAIL"}.intersection(body.replace(":", " ").split())
