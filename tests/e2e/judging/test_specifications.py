"""Specifications by the commands: entered, revised, withdrawn, edited behind the store's back, restored."""

import csv
import json
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

LIMIT = """
[[limit]]
metric = "bias"
parameters = {{ earth_rate = "none" }}
upper = {upper}
unit_of_measure = "deg/h"
"""

Ask = Callable[..., Result]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """A unit with a bias of 1.5 deg/h, at rest for 4000 s on 5 January 2026."""
    here = tmp_path_factory.mktemp("specifications")
    values = np.random.default_rng(5).normal(1.5, 0.5, 4000)
    with (here / "long.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["unit", "time[s]", "rate[deg/h]", "procedure", "step"])
        writer.writerows(["FOG-0001", at, f"{value:.6f}", "static_bias", "static"] for at, value in enumerate(values))
    words = ("import", "long.csv", "--store", "S", "--start", "2026-01-05T08:00:00Z")
    assert run_command(*words, cwd=here).code == 0
    return here / "S"


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "S"))


@pytest.fixture
def ask(folder: Path) -> Ask:
    def run(*words: object, code: int = 0, store: Path = folder) -> Result:
        done = CliRunner().invoke(main, [*(str(word) for word in words), "--store", str(store)])
        assert done.exit_code == code, (done.output, done.exception)
        return done

    return run


def file(folder: Path, revision: str, upper: float, head: str = "") -> Path:
    path = folder.parent / "fog.toml"
    path.write_text(f'revision = "{revision}"\n{head}\n{LIMIT.format(upper=upper)}')
    return path


def reported(ask: Ask, **words: Any) -> Any:
    """What `verdicts` says."""
    return json.loads(ask("verdicts", "--json", **words).stdout)


@pytest.mark.long
def test_what_is_entered_later_or_edited_changes_no_verdict_and_the_log_alone_gives_it_again(
    ask: Ask, folder: Path
) -> None:
    ask("limits", "add", file(folder, "A", 2.0), "--by", "Li", "--reason", "order 7")
    before = reported(ask)
    assert [(row["unit"], row["verdict"]) for row in before["units"]] == [("FOG-0001", "PASS")]
    refused = ask("limits", "revise", file(folder, "B", 1.0, "valid_from = 2026-01-01"), code=2)
    assert "--reason" in refused.output  # who revises says why
    for revision, begin in (("B", "2026-01-01"), ("C", "2030-01-01")):
        done = ask(
            "limits", "revise", file(folder, revision, 1.0, f"valid_from = {begin}"), "--by", "Wu", "--reason", "x"
        )
        assert "keeps its verdicts" in done.stderr
    assert reported(ask) == before
    history = json.loads(ask("limits", "history", "--json").stdout)
    assert [(each["document"]["action"], each["document"]["revision"], each["document"]["by"]) for each in history] == [
        ("added", "A", "Li"), ("revised", "B", "Wu"), ("revised", "C", "Wu"),
    ]  # fmt: skip
    assert [each["document"].get("previous", "") for each in history[1:]] == [each["sha256"] for each in history[:-1]]
    assert "order 7" in ask("limits", "history").stdout

    copy = folder / "products" / "fog-A.toml"
    copy.chmod(0o644)
    copy.write_text(copy.read_text().replace("2.0", "0.1"))
    (folder / "products" / "new-A.toml").write_text(f'revision = "A"\n{LIMIT.format(upper=0.1)}')
    assert reported(ask) == before
    assert "fog-A.toml: it is not what was entered" in ask("verdicts").stderr
    found = json.loads(ask("verify", "--json", code=1).stdout)
    assert sorted(each["kind"] for each in found["findings"]) == [
        "specification_copy_changed", "specification_not_entered",
    ]  # fmt: skip
    (folder / "products" / "new-A.toml").unlink()
    ask("recover")
    assert "2.0" in copy.read_text()
    ask("verify")

    restored = folder.parent / "restored"
    restored.mkdir()
    shutil.copytree(folder / "log", restored / "log")
    ask("recover", store=restored)
    assert reported(ask, store=restored) == before
    rows = json.loads(ask("sql", "select unit, verdict from unit_verdicts", "--json", store=restored).stdout)
    assert rows == [{"unit": "FOG-0001", "verdict": "PASS"}]
    assert ask("limits", "show", "fog-A", "--toml", store=restored).stdout == copy.read_text()


@pytest.mark.long
def test_a_store_is_judged_anew_where_a_person_says_so(ask: Ask, folder: Path) -> None:
    ask("limits", "add", file(folder, "A", 2.0))
    ask("limits", "revise", file(folder, "B", 1.0, "valid_from = 2026-01-01"), "--reason", "typing error", "--rejudge")
    assert [(row["revision"], row["verdict"]) for row in reported(ask)["verdicts"]] == [("B", "FAIL")]
    done = ask("limits", "withdraw", "fog-B", "--reason", "it was right", "--rejudge")
    assert "fog-B: withdrawn" in done.stdout
    assert [(row["revision"], row["verdict"]) for row in reported(ask)["verdicts"]] == [("A", "PASS")]
    (listed,) = json.loads(ask("limits", "list", "--json").stdout)
    assert (listed["revision"], listed["valid_until"]) == ("A", None)
    assert "whole" in ask("limits", "settle", "--reason", "x", code=1).output


@pytest.mark.long
def test_a_revision_that_is_there_judges_anew_when_it_is_asked_to(ask: Ask, folder: Path) -> None:
    ask("limits", "add", file(folder, "A", 2.0))
    revised = ("limits", "revise", file(folder, "B", 1.0, "valid_from = 2026-01-01"), "--reason", "typing error")
    assert "with --rejudge it would be judged again" in ask(*revised).stderr
    assert [(row["revision"], row["verdict"]) for row in reported(ask)["verdicts"]] == [("A", "PASS")]
    done = ask(*revised, "--rejudge")
    assert "are there already" in done.stdout
    assert "What was recorded before is judged again" in done.stderr
    assert [(row["revision"], row["verdict"]) for row in reported(ask)["verdicts"]] == [("B", "FAIL")]
    ask("verify")
    history = json.loads(ask("limits", "history", "--json").stdout)
    ask(*revised)  # without it, nothing is entered again
    assert json.loads(ask("limits", "history", "--json").stdout) == history


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('metric = "bais"\nupper = 1.0', "did you mean bias?"),
        (
            'metric = "bias_stability_averaged"\nparameters = { average_ss = 100 }\nupper = 1.0',
            "did you mean average_s?",
        ),
    ],
)
def test_unknown_metrics_and_parameters_are_refused(ask: Ask, folder: Path, text: str, said: str) -> None:
    path = folder.parent / "bad.toml"
    path.write_text(f'revision = "A"\n[[limit]]\n{text}\nunit_of_measure = "deg/h"\n')
    assert said in json.loads(ask("limits", "add", path, "--json", code=1).stdout)["error"]["message"]
    assert json.loads(ask("limits", "list", "--json").stdout) == []


def test_a_recorder_at_work_takes_a_specification_and_it_counts_at_once(
    spawn: Callable[..., subprocess.Popen[str]], endpoint: str, tmp_path: Path
) -> None:
    recorder = spawn("record", "--listen", endpoint, "--store", "S", "--json")
    assert recorder.stdout is not None
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    path = tmp_path / "fog.toml"
    path.write_text(f'revision = "A"\n{LIMIT.format(upper=1.0)}')
    folder = str(tmp_path / "S")
    done = CliRunner().invoke(main, ["limits", "add", str(path), "--store", folder])
    assert done.exit_code == 0, done.output
    (listed,) = json.loads(CliRunner().invoke(main, ["limits", "list", "--store", folder, "--json"]).stdout)
    assert listed["revision"] == "A"
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=30)
    assert recorder.returncode == 0
    (kept,) = json.loads(CliRunner().invoke(main, ["limits", "history", "--store", folder, "--json"]).stdout)
    assert kept["document"]["revision"] == "A"


def test_the_help_names_only_options_that_there_are() -> None:
    said = CliRunner().invoke(main, ["limits", "--help"]).output
    assert "gyrofleet run" not in said
    assert "--limits" in CliRunner().invoke(main, ["allan", "--help"]).output
