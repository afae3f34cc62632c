"""People at a station: they stop, pause, confirm and abort a procedure, and begin several of a day."""

import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.forked_commands import CommandServer

Bench = Any
Kept = Any
Spawn = Callable[..., subprocess.Popen[str]]
Gyrofleet = Callable[..., Any]

SHORT = ("--set", "startup_s=4", "--set", "rate_record_s=4", "--set", "off_between_rates_s=1")


@pytest.mark.long
def test_stopped_by_ctrl_c_the_station_is_safe_and_the_run_goes_on_later(
    gyrofleet: Gyrofleet, store: Path, kept: Kept, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    command = bench.run("scale_factor", *SHORT)
    bench.tell("chamber", "TEMP:SETP 40")
    process = spawn(*command)
    state(lambda run: run["step"] >= 4)
    assert abs(float(bench.ask("table", "RATE:ACT?"))) > 1.0
    process.send_signal(signal.SIGINT)
    reported, _ = bench.ended(process, code=130)
    assert reported["event"] == "interrupted"
    assert "same command" in reported["remark"]
    assert bench.is_safe()
    bench.tell("chamber", f"TEMP:SETP {bench.room_deg_c}")
    assert "other steps of scale_factor" in bench.refused(bench.run("scale_factor", "--set", "startup_s=3"), store)
    one = bench.folder / "one.csv"
    one.write_text("serial\nSIM-0001\n")
    other = bench.refused(bench.run("scale_factor", *SHORT, "--run", reported["run"], "--units", one), store)
    assert "other units (new now: none; gone: SIM-0002)" in other
    turned = bench.folder / "turned.csv"
    turned.write_text("serial\nSIM-0002\nSIM-0001\n")  # the order of scanning means nothing
    last, _ = bench.ended(spawn(*bench.run("scale_factor", *SHORT, "--units", turned)))
    assert last["run"] == reported["run"]
    kept.completed()
    kept.sound()
    assert bench.is_safe()


def test_an_operator_confirms_pauses_and_aborts(bench: Bench, tmp_path: Path, command_server: CommandServer) -> None:
    words = [str(word) for word in bench.run("scale_factor", *SHORT) if word not in {"--yes", "--json"}]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = command_server.start(words, cwd=tmp_path, bufsize=1, **pipes)
    try:
        assert process.stdin is not None
        assert process.stderr is not None

        def until(part: str) -> None:
            for line in process.stderr or ():
                if part in line:
                    return
            raise AssertionError(f"{part!r} was not said")

        until("then press Enter")
        time.sleep(0.5)
        assert bench.ask("table", "RATE:ACT?") == "0.000000"
        run = next((tmp_path / "S" / "spool").glob("*/procedure.json"))
        assert json.loads(run.read_bytes())["step"] == 0, "it was to wait"
        process.stdin.write("what\n")
        until("Ctrl-C stops")
        process.stdin.write("\n")
        deadline = time.monotonic() + 20
        while json.loads(run.read_bytes())["step"] < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        process.stdin.write("p\n")
        until("is paused")
        step = json.loads(run.read_bytes())["step"]
        time.sleep(1.0)
        assert json.loads(run.read_bytes())["step"] == step
        process.stdin.write("c\n")
        until("goes on")
        while json.loads(run.read_bytes())["step"] <= step and time.monotonic() < deadline:
            time.sleep(0.02)
        process.stdin.write("a\n")
        out, err = process.communicate(timeout=30)
        assert process.returncode == 1, err
        assert "(aborted)" in out
        assert bench.is_safe()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.long
def test_without_an_operator_a_prompt_ends_the_run_instead_of_waiting_for_ever(
    gyrofleet: Gyrofleet, bench: Bench
) -> None:
    words = [word for word in bench.run("static_bias") if word != "--yes"]
    refused = gyrofleet(*words)  # its standard input is empty
    assert refused.code == 1
    assert "nobody can confirm" in refused.out + refused.err
    assert bench.is_safe()
    aborted = gyrofleet(*bench.run("static_bias", "--end"))
    assert aborted.code == 0
    assert json.loads(aborted.out.splitlines()[-1])["outcome"] == "stopped"


@pytest.mark.long
def test_runs_of_a_day_have_letters_and_an_overdue_calibration_is_said_and_a_station_has_one_run_at_a_time(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    quick = ("--set", "bias_record_s=10", "--set", "warm_up_s=0")
    overdue = bench.folder / "overdue.toml"
    overdue.write_text(
        (bench.folder / "station.toml")
        .read_text()
        .replace('kind = "rate_table"', 'kind = "rate_table"\nserial = "T-7"\ncalibration_due = 2020-03-31')
    )
    first = gyrofleet(*bench.run("static_bias", *quick, "--station", overdue))
    assert first.code == 0, first.err
    assert json.loads(first.out.splitlines()[-1])["run"].endswith("-static_bias-A")
    warning = "warning: the rate_table table, serial T-7 was due for calibration on 2020-03-31"
    assert warning in first.err
    assert {"text": warning} in kept.rows("select document->>'$.text' as text from events where kind = 'NoteAdded'")
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=100000"))
    state(lambda run: True)
    other = gyrofleet(*bench.run("static_bias", *quick, "--store", "other"))
    assert other.code == 1
    assert "another gyrofleet run is at work at station bench" in other.json["error"]["message"]
    process.send_signal(signal.SIGINT)
    reported, _ = bench.ended(process, code=130)
    assert reported["run"].endswith("-B")
    one = bench.folder / "only.csv"
    one.write_text("serial\nSIM-0001\n")
    done = gyrofleet(*bench.run("static_bias", *quick, "--units", one))
    assert json.loads(done.out.splitlines()[-1])["run"].endswith("-C")
    assert f"run {reported['run']} of SIM-0001, SIM-0002 was left unfinished" in done.err
