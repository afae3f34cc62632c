"""Runs are paused, resumed and aborted from elsewhere: over HTTP, on the command line, through kills and silence."""

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from storage.recording.command_box import GIVEN, TAKEN, CommandFolder, RunCommand
from storage.recording.run_command import GivenCommand, give_command, is_at_work
from storage.store import Store
from stream.events import CommandOutcome, RunAction
from stream.status.role_status import boot
from tests.analytics.serve.conftest import PASSWORD, TOKEN, Served, start, write_users
from tests.forked_commands import CommandServer

Bench = Any
Kept = Any
Gyrofleet = Callable[..., Any]
Spawn = Callable[..., "subprocess.Popen[str]"]
State = Callable[[Callable[[dict[str, Any]], bool]], dict[str, Any]]

SHORT = ("--set", "startup_s=4", "--set", "rate_record_s=40", "--set", "off_between_rates_s=1")
QUICK = ("--set", "startup_s=4", "--set", "rate_record_s=10", "--set", "off_between_rates_s=1")  # for runs to their end
COMMANDS = """
select kind, document->>'$.action' as action, document->>'$.by' as by, document->>'$.reason' as reason,
  document->>'$.outcome' as outcome, document->>'$.text' as text, coalesce(document->>'$.command', uid) as command
from events where kind like 'RunCommand%' order by t_ns, kind desc, outcome
"""


@pytest.fixture
def served(tmp_path: Path, store: Path, command_server: CommandServer) -> Iterator[Served]:
    """A server over the store of this test's runs, in a process of its own."""
    Store.create(store)
    tokens = write_users(tmp_path / "users.toml")
    process, ready = start(
        command_server, "--store", "S", "--port", 0, "--token", TOKEN, "--users", "users.toml", cwd=tmp_path
    )
    yield Served(ready["url"], tmp_path, tokens)
    process.terminate()
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in err, err


def at_work(store: Path, state: State, has_come: Callable[[dict[str, Any]], bool] = lambda _: True) -> str:
    """The run, once its station takes commands."""
    run: str = state(has_come)["run"]
    deadline = time.monotonic() + 20
    while not is_at_work(store, run):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return run


def stays(store: Path, run: str, for_s: float = 1.0) -> int:
    """The step at which the run stays."""
    path = store / "spool" / run / "procedure.json"
    step: int = json.loads(path.read_bytes())["step"]
    time.sleep(for_s)
    assert json.loads(path.read_bytes())["step"] == step
    return step


@pytest.mark.long
def test_an_operator_pauses_resumes_and_aborts_over_http(
    served: Served, store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept, gyrofleet: Gyrofleet
) -> None:
    process = spawn(*bench.run("scale_factor", *SHORT))
    run = at_work(store, state, lambda found: found["step"] >= 2 and found["open_steps"])
    url = f"/api/runs/{run}/commands"
    with served.program("viewer") as viewer:
        refused = viewer.post(url, json={"action": "abort", "reason": "curious"})
        assert refused.status_code == 403, refused.text
    with served.nobody() as nobody:
        assert nobody.post(url, json={"action": "abort", "reason": "curious"}).status_code == 401
    with served.browser("otto", PASSWORD) as browser:
        assert browser.post(url, json={"action": "abort", "reason": "x"}).status_code == 403, "no secret of the session"
        form = {"path.run": run, "action": "pause", "reason": "door open", "back": f"/runs/{run}"}
        assert browser.post("/act/command_run", data=form).status_code == 403
        page = browser.post("/act/command_run", data=form | {"csrf": browser.csrf})
        assert page.status_code == 200, page.text
        assert "door open" in page.text  # the page shows the command
        page = browser.post("/act/command_run", data=form | {"csrf": browser.csrf, "reason": "twice"})
        assert page.status_code == 409
        assert "it is paused already" in page.text
    with served.program("operator") as operator:
        step = stays(store, run)
        # a pause switches nothing; what the run says of it may be a moment old
        state(lambda found: bench.ask("supply", "OUTP?") == str(int(found["is_powered"])))
        noted = operator.post("/api/notes", json={"run": run, "text": "a lamp went out"})
        assert noted.status_code == 200, noted.text  # the process of the run alone can write the log
        course = operator.get(f"/api/runs/{run}/course").json()
        assert [each["text"] for each in course["notes"] if each["author"] == "operator-program"] == ["a lamp went out"]
        assert course["is_live"]
        assert [row["outcome"] for row in course["commands"]] == ["refused", "done"]
        for wrong, status in (
            ({"action": "pause"}, 400), ({"action": "explode", "reason": "x"}, 400),
            ({"action": "resume", "reason": "  "}, 400), ({"action": "pause", "reason": "again"}, 409),
        ):  # fmt: skip
            assert operator.post(url, json=wrong).status_code == status, wrong
        answer = operator.post("/api/runs/nowhere/commands", json={"action": "pause", "reason": "x"})
        assert answer.status_code == 404, answer.text
        answer = operator.post(url, json={"action": "resume", "reason": "door shut"})
        assert answer.status_code == 200, answer.text
        assert answer.json()["outcome"] == "done"
        state(lambda found: found["step"] > step)
        done = gyrofleet("control", run, "resume", "--reason", "impatient", "--by", "Li", "--store", "S", "--json")
        assert (done.code, done.json["outcome"]) == (1, "refused"), done.err
        answer = operator.post(url, json={"action": "abort", "reason": "smoke"})
        assert (answer.status_code, answer.json()["outcome"]) in {(202, "accepted"), (200, "done")}, answer.text
        reported, _ = bench.ended(process, code=1)
        assert reported["outcome"] == "aborted"
        assert bench.is_safe()
        over = operator.post(url, json={"action": "resume", "reason": "regret"})
        assert over.status_code == 409
        assert "has ended (aborted)" in over.json()["error"]["message"]
    with served.program("engineer") as flood:
        codes: list[int] = []
        while 429 not in codes and len(codes) < 60:
            codes.append(flood.post(url, json={"action": "abort", "reason": "!"}).status_code)
        assert set(codes) == {409, 429}, codes
    kept.sound()
    rows = [row for row in kept.rows(COMMANDS) if row["by"] != "engineer-program"]
    given = {row["command"]: (row["action"], row["by"], row["reason"]) for row in rows if row["by"]}
    answers = [(*given[row["command"]], row["outcome"]) for row in rows if row["command"] in given and row["outcome"]]
    otto, program = "otto", "operator-program"
    assert sorted(answers) == sorted(
        [
            ("pause", otto, "door open", "done"),
            ("pause", otto, "twice", "refused"),
            ("pause", program, "again", "refused"),
            ("resume", program, "door shut", "done"),
            ("resume", "Li", "impatient", "refused"),
            ("abort", program, "smoke", "accepted"),
            ("abort", program, "smoke", "done"),
            ("resume", program, "regret", "refused"),
        ]
    )
    assert "curious" not in json.dumps(rows)
    (note,) = kept.rows("select document->>'$.author' as author from events where document->>'$.text' like 'a lamp%'")
    assert note["author"] == "operator-program"


@pytest.mark.long
def test_a_run_that_sends_to_a_recorder_takes_commands_too(
    store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept, endpoint: str
) -> None:
    record = spawn("record", "--listen", endpoint, "--store", "S", "--json")
    assert record.stdout is not None
    assert json.loads(record.stdout.readline())["event"] == "recording"
    process = spawn(*bench.run("scale_factor", *SHORT))
    run = at_work(store, state, lambda found: found["step"] >= 2)
    opened = Store.open(store)
    outcomes = [
        give_command(opened, run, action, by="Li", reason="try", patience_s=20.0).answer.outcome
        for action in (RunAction.PAUSE, RunAction.RESUME, RunAction.ABORT)
    ]
    assert outcomes == [CommandOutcome.DONE] * 3
    bench.ended(process, code=1)
    assert bench.is_safe()
    record.send_signal(signal.SIGINT)
    record.communicate(timeout=60)
    kept.sound()
    answers = [row["outcome"] for row in kept.rows(COMMANDS) if row["outcome"]]
    assert answers == ["done", "done", "accepted", "done"]


@contextmanager
def stopped(process: "subprocess.Popen[str]") -> Iterator[None]:
    """A process that does nothing for a while."""
    process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


@pytest.mark.long
def test_a_station_that_does_not_answer_is_told_of_and_does_nothing_later(
    served: Served, store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept
) -> None:
    process = spawn(*bench.run("scale_factor", *QUICK))
    run = at_work(store, state, lambda found: found["step"] >= 2)
    with served.program("operator") as operator:
        with stopped(process):
            began_s = time.monotonic()
            answer = operator.post(f"/api/runs/{run}/commands", json={"action": "abort", "reason": "is it there"})
            assert answer.status_code == 409
            assert "withdrawn" in answer.json()["error"]["message"]
            assert time.monotonic() - began_s < 12.0
            (row,) = operator.get(f"/api/runs/{run}/commands").json()["commands"]  # not in the log yet
            assert (row["by"], row["reason"], row["outcome"]) == ("operator-program", "is it there", "unanswered")
        reported, _ = bench.ended(process)
        assert reported["outcome"] == "completed"
    kept.sound()
    kept.completed()
    assert [(row["action"], row["outcome"]) for row in kept.rows(COMMANDS)] == [("abort", None), (None, "unanswered")]


def test_an_abort_stands_while_the_station_waits_for_an_instrument(
    gyrofleet: Gyrofleet, store: Path, slow: Bench, spawn: Spawn, state: State, kept: Kept
) -> None:
    """For 6 s it takes nothing; a pause would be withdrawn after 5 s."""
    process = spawn(*slow.run("scale_factor", *SHORT))
    run = at_work(store, state, lambda found: found["step"] >= 2)
    with stopped(process):
        waiting = spawn("control", run, "abort", "--reason", "smoke", "--by", "Li", "--store", "S")
        time.sleep(6.0)
    out, err = waiting.communicate(timeout=60)
    assert waiting.returncode == 0, (out, err)
    assert "abort done" in out
    assert "the command stands for 60 s" in err
    reported, _ = slow.ended(process, code=1)
    assert reported["outcome"] == "aborted"
    assert slow.is_safe()
    kept.sound()


def command(run: str, action: RunAction, name: str) -> RunCommand:
    now_ns = time.time_ns()
    return RunCommand(
        id=name, run=run, action=action, by="Li", reason=name, given_ns=now_ns, expires_ns=now_ns + 60 * 10**9
    )


@pytest.mark.long
def test_a_command_is_carried_out_at_most_once_through_kills(
    store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept
) -> None:
    """Killed before the station takes a command, between taking and deciding it, and before its answer is told."""
    words = bench.run("scale_factor", *QUICK)
    process = spawn(*words)
    run = at_work(store, state, lambda found: found["step"] >= 2)
    opened = Store.open(store)
    with stopped(process):  # given, not taken, and killed
        answers: list[GivenCommand] = []
        give = lambda: answers.append(give_command(opened, run, RunAction.ABORT, by="Li", reason="1", patience_s=60.0))  # noqa: E731
        giving = threading.Thread(target=give)
        giving.start()
        with CommandFolder(store, run) as folder:
            while not folder.names(GIVEN):
                time.sleep(0.01)
        process.kill()
    process.wait()
    giving.join(20)
    assert answers[0].answer.outcome is CommandOutcome.REFUSED
    with CommandFolder(store, run) as folder:  # taken and killed
        folder.write("taken", TAKEN, command(run, RunAction.ABORT, "taken"))
        folder.write("late", GIVEN, msgspec.structs.replace(command(run, RunAction.ABORT, "late"), expires_ns=1))
        # the clock was set back since: by it there is time left
        over = msgspec.structs.replace(command(run, RunAction.ABORT, "over"), boot=boot(), expires_uptime_ns=1)
        folder.write("over", GIVEN, over)
    process = spawn(*words)
    at_work(store, state, lambda found: "late" in found["commands"])
    paused = give_command(opened, run, RunAction.PAUSE, by="Li", reason="hold", patience_s=20.0)
    assert paused.answer.outcome is CommandOutcome.DONE, paused
    step = stays(store, run, 0.5)
    process.kill()
    process.wait()
    with CommandFolder(store, run) as folder:  # decided, and killed before its file was gone
        folder.write(paused.command.id, TAKEN, paused.command)
    process = spawn(*words)
    at_work(store, state, lambda found: found["starts"] == 3)
    assert stays(store, run, 1.0) == step, "it stays paused"
    resumed = give_command(opened, run, RunAction.RESUME, by="Li", reason="go on", patience_s=20.0)
    assert resumed.answer.outcome is CommandOutcome.DONE
    reported, _ = bench.ended(process)
    assert reported["outcome"] == "completed"
    kept.completed()
    kept.sound()
    rows = kept.rows(COMMANDS)
    reasons = {row["command"]: row["reason"] for row in rows if row["reason"]}
    assert sorted((reasons[row["command"]], row["outcome"]) for row in rows if row["outcome"]) == [
        ("1", "refused"), ("go on", "done"), ("hold", "done"), ("late", "refused"),
        ("over", "refused"), ("taken", "refused"),
    ]  # fmt: skip
    assert len(reasons) == sum(1 for row in rows if row["reason"]) == 6, "each once"


@pytest.mark.long
def test_an_abort_that_was_accepted_is_finished_after_a_kill(
    store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept
) -> None:
    words = bench.run("scale_factor", *SHORT)
    process = spawn(*words)
    run = at_work(store, state, lambda found: found["step"] >= 2 and found["open_steps"])
    instruments = bench.role("instruments")
    os.kill(instruments, signal.SIGSTOP)  # the station cannot be made safe meanwhile
    try:
        given = give_command(Store.open(store), run, RunAction.ABORT, by="Li", reason="smoke", patience_s=2.0)
        process.kill()
        process.wait()
    finally:
        os.kill(instruments, signal.SIGCONT)
    assert given.answer.outcome is CommandOutcome.ACCEPTED, given
    assert bench.process.poll() is None
    reported, _ = bench.ended(spawn(*words), code=1)
    assert (reported["run"], reported["outcome"]) == (run, "aborted")
    assert bench.is_safe()
    kept.sound()
    assert [row["outcome"] for row in kept.rows(COMMANDS) if row["outcome"]] == ["accepted", "done"]
    (last,) = kept.rows("select document->>'$.outcome' as outcome from events where kind = 'RunEnded'")
    assert last["outcome"] == "aborted"


@pytest.mark.long
def test_a_table_that_acknowledges_and_goes_on_turning_is_not_called_safe(
    store: Path, slow: Bench, spawn: Spawn, state: State, kept: Kept, gyrofleet: Gyrofleet
) -> None:
    process = spawn(*slow.run("scale_factor", *SHORT))
    run = at_work(store, state, lambda found: found["step"] >= 2 and found["open_steps"])
    turning = float(slow.ask("table", "RATE:ACT?"))
    slow.tell("table", "SIM:FAULT UNSETTLED")
    try:
        done = gyrofleet("control", run, "abort", "--reason", "smoke", "--store", "S", "--json")
        reported, err = slow.ended(process, code=1)
    finally:
        slow.tell("table", "SIM:FAULT NONE")
    assert abs(turning) > 1.0
    answer = json.loads(done.out)
    assert (done.code, answer["outcome"], answer["unsafe"]) == (1, "done", ["table"])
    sentence = f"table could not be made safe: rate is commanded to 0 deg/s, {turning:.0f}"
    assert answer["text"].startswith(f"the run is aborted; {sentence}")
    assert f"warning: {sentence}" in err
    assert "the station is being made safe" in err
    assert "made safe;" not in err.replace("being made safe", "")
    assert reported["outcome"] == "aborted"
    assert [row["text"] for row in kept.rows(COMMANDS) if row["outcome"] == "done"] == [answer["text"]]


@pytest.mark.long
def test_a_command_that_others_can_write_is_not_carried_out(
    store: Path, bench: Bench, spawn: Spawn, state: State, kept: Kept
) -> None:
    process = spawn(*bench.run("static_bias", "--set", "warm_up_s=0", "--set", "bias_record_s=400"))
    run = at_work(store, state, lambda found: bool(found["open_steps"]))
    with CommandFolder(store, run) as folder:
        forged = folder.path / "forged"
        forged.write_bytes(msgspec.json.encode(command(run, RunAction.ABORT, "forged")))
        forged.chmod(0o666)
        forged.rename(folder.path / "forged.given")
    reported, err = bench.ended(process)
    assert reported["outcome"] == "completed"
    assert "is open to others (mode 0666)" in err
    assert kept.rows(COMMANDS) == []
    (note,) = kept.rows("select document->>'$.text' as text from events where document->>'$.text' like '%forged%'")
    assert "was not carried out" in note["text"]
