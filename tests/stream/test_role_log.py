"""Logs of roles: one line each, as text or JSON, from a level on; libraries, threads and errors in the same form."""

import json
import subprocess
import sys
from typing import Any

import pytest

SCRIPT = """
import logging, sys, threading
import click
from stream.terminal.console import reporting
from stream.errors import BadInput
from stream.roles.role_log import RoleLog, logged

@click.command()
@reporting
@logged("record")
def command(as_json):
    log = RoleLog("record")
    log.write("debug", "detail", "seen by few")
    log.write("info", "recording", "unit FOG\\x1b[31m-1, \\u9640\\u87ba", samples=3)
    log.write("warning", "disk_low", "2 lines\\nof text")
    logging.getLogger("some.library").warning("odd %s", "thing")
    logging.getLogger("some.library").info("not shown")
    thread = threading.Thread(target=lambda: 1 / 0, name="writer")
    thread.start()
    thread.join()
    raise BadInput("the end")

command()
"""


def run(*words: str) -> tuple[int, list[str]]:
    done = subprocess.run([sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, check=False)
    assert done.stdout == ""
    return done.returncode, done.stderr.splitlines()


def test_json_is_one_object_a_line_with_everything_in_it() -> None:
    code, lines = run("--log-format", "json", "--log-level", "debug")
    found: list[dict[str, Any]] = [json.loads(line) for line in lines]
    assert code == 1
    assert all({"at", "level", "role", "event", "text"} <= each.keys() for each in found)
    assert {each["role"] for each in found} == {"record"}
    assert [(each["level"], each["event"]) for each in found] == [
        ("debug", "detail"), ("info", "recording"), ("warning", "disk_low"), ("warning", "library"),
        ("error", "thread_failed"), ("error", "failed"),
    ]  # fmt: skip
    recording, library, thread, end = found[1], found[3], found[4], found[5]
    assert (recording["text"], recording["samples"]) == ("unit FOG\x1b[31m-1, 陀螺", 3)
    assert library["text"] == "odd thing"
    assert thread["text"] == "ZeroDivisionError in the thread writer: division by zero"
    assert thread["exception"].endswith("ZeroDivisionError: division by zero")
    assert end["text"] == "the end"


def test_text_has_times_and_levels_and_no_escapes_of_a_terminal() -> None:
    code, lines = run()
    assert code == 1
    assert lines[0][19:] == r" unit FOG\x1b[31m-1, 陀螺"
    assert lines[1][19:] == " warning: 2 lines"
    assert any(line.endswith(" error: ZeroDivisionError in the thread writer: division by zero") for line in lines)
    assert "seen by few" not in "".join(lines)
    assert lines[-1].endswith("error: the end")


@pytest.mark.long
@pytest.mark.parametrize(("level", "events"), [
    ("debug", ["detail", "recording", "disk_low", "library", "thread_failed", "failed"]),
    ("info", ["recording", "disk_low", "library", "thread_failed", "failed"]),
    ("warning", ["disk_low", "library", "thread_failed", "failed"]),
    ("error", ["thread_failed", "failed"]),
])  # fmt: skip
def test_lower_levels_are_left_out(level: str, events: list[str]) -> None:
    _, lines = run("--log-format", "json", "--log-level", level)
    assert [json.loads(line)["event"] for line in lines] == events


@pytest.mark.parametrize(("address", "is_open"), [("0.0.0.0:0", True), ("[::]:0", True), ("127.0.0.1:0", False)])
def test_a_status_that_others_can_read_is_warned_of_once(address: str, is_open: bool) -> None:
    script = (
        SCRIPT.replace("@click.command()\n", "@click.command()\n@status_listen_option\n")
        .replace("def command(as_json):", "def command(as_json, status_listen):")
        .replace("console import reporting", "console import reporting, status_listen_option")
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "--status-listen", address], capture_output=True, text=True, check=False
    )
    warned = [line for line in done.stderr.splitlines() if "anybody who reaches this computer can read" in line]
    assert len(warned) == is_open
    assert all(f" warning: --status-listen {address}: " in line for line in warned)
