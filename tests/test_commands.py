"""Help of every command on a terminal of 80 columns, and completion in a shell."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import gyrofleet


def commands(group: click.Group, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield path, group
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        assert command.name == name
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


ALL = list(commands(gyrofleet.main))


@pytest.mark.parametrize(("path", "command"), ALL, ids=[" ".join(path) or "gyrofleet" for path, _ in ALL])
def test_help_is_whole_at_80_columns(path: tuple[str, ...], command: click.Command) -> None:
    shown = CliRunner().invoke(gyrofleet.main, [*path, "--help"], terminal_width=80)
    assert shown.exit_code == 0
    assert max(map(len, shown.output.splitlines())) <= 80
    assert command.help
    for line in shown.output.splitlines():
        assert not line.endswith("...") or line.startswith("Usage:"), f"cut off: {line}"


def complete(words: str, folder: Path) -> list[str]:
    environment = {
        **os.environ,
        "_GYROFLEET_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    command = [sys.executable, "-c", "import gyrofleet; gyrofleet.main(prog_name='gyrofleet')"]
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""
    return [line.split(",", 1)[1] for line in done.stdout.splitlines() if "," in line]


def test_the_shell_completes_commands(tmp_path: Path) -> None:
    assert complete("gyrofleet ver", tmp_path) == ["verdicts", "verify"]


@pytest.mark.long
def test_without_a_store_units_complete_to_nothing(tmp_path: Path) -> None:
    assert complete("gyrofleet allan --unit FO", tmp_path) == []


@pytest.mark.long
def test_metrics_and_procedures_complete_without_a_store(tmp_path: Path) -> None:
    assert "bias_stability" in complete("gyrofleet metrics --metric bias_", tmp_path)
    assert "static_bias" in complete("gyrofleet procedure show static_", tmp_path)


@pytest.mark.long
def test_a_terminal_without_greek_letters_gets_question_marks(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gyrofleet", "procedure", "list"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.isascii()


WITH_CAN = (["import", "drive.blf", "--dbc", "g.dbc", "--unit", "G"], ["can", "scan", "drive.blf", "--dbc", "g.dbc"])
BLOCKED = """
import sys
for name in ("can", "cantools", "serial", "pyvisa", "msgpack"):
    sys.modules[name] = None
import gyrofleet
gyrofleet.main({words}, prog_name="gyrofleet")
"""


@pytest.mark.long
@pytest.mark.parametrize("words", WITH_CAN)
def test_without_the_station_extra_a_command_names_it(words: list[str], tmp_path: Path) -> None:
    (tmp_path / "drive.blf").write_bytes(b"LOGG")
    (tmp_path / "g.dbc").write_text("")
    command = [sys.executable, "-c", BLOCKED.format(words=words)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "pip install 'gyrofleet[station]'" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_without_the_station_extra_files_are_imported_and_asked(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n0,1\n1,2\n")
    for words in (["import", "a.csv", "--unit", "G-1"], ["sql", "select count(*) from samples", "--json"]):
        command = [sys.executable, "-c", BLOCKED.format(words=words)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr


SLOW = (
    "duckdb", "matplotlib", "numba", "pandas", "pint", "polars", "pyarrow.parquet", "scipy.optimize", "scipy.special",
    "scipy.stats", "zenoh",
)  # fmt: skip
# runs a command, and prints which of these libraries it has imported: an import at its first row
PROGRAM = """
import sys
import gyrofleet
from stream.delivery.publisher import DurablePublisher

words, libraries = sys.argv[1:], {libraries}
imported = lambda: [each for each in libraries if each in sys.modules]
send = DurablePublisher.send_batch
at_first_row = []


def sent(self, key, batch):
    at_first_row.append(imported())
    send(self, key, batch)


assert not set(sys.modules) & {{*libraries, "duckdb", "pyarrow", "scipy"}}
DurablePublisher.send_batch = sent
try:
    gyrofleet.main(words, standalone_mode=False)
finally:
    print(*(at_first_row[0] if at_first_row else imported()))
"""


@pytest.mark.long
def test_a_command_imports_no_slow_library_that_it_does_not_need(tmp_path: Path) -> None:
    """Rows of a file are on their way, and a store is asked, before compiled code or tables of units are loaded."""
    (tmp_path / "r.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{i},{i % 3}\n" for i in range(200)))
    needed = {
        ("import", "r.csv", "--unit", "U"): {"zenoh"},
        ("sql", "select count(*) from samples", "--json"): set(),
        ("metrics", "--metric", "bias", "--json"): {"pandas", "polars", "scipy.special"},  # computed
        ("metrics", "--metric", "bias", "--json", "--lang", "en"): {"pandas"},  # kept
        ("trend", "bias", "--json"): {"pandas", "polars", "scipy.optimize", "scipy.special"},
    }
    tables = {"duckdb", "pyarrow.parquet"}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for words, libraries in needed.items():
        command = [sys.executable, "-P", "-c", PROGRAM.format(libraries=SLOW), *words, "--store", "S"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert "Traceback" not in done.stderr, done.stderr
        assert set(done.stdout.splitlines()[-1].split()) <= libraries | (tables if words[0] != "import" else set()), (
            words
        )


def test_a_command_is_loaded_alone() -> None:
    """Without the modules of the others."""
    script = (
        "import sys, gyrofleet\n"
        "try: gyrofleet.main(['status', '--help'])\n"
        "except SystemExit: pass\n"
        "print(*(each for each in sys.modules if '.commands.' in each), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr.split() == ["storage.commands.status"]


@pytest.mark.parametrize(("before", "code"), [("default_int_handler", -signal.SIGINT), ("SIG_IGN", 0)])
def test_an_interrupt_while_libraries_load_has_no_traceback(before: str, code: int) -> None:
    """One that is ignored, as of a process in the background, stays ignored."""
    script = (
        f"import os, signal, sys; sys.argv[0] = 'gyrofleet'; signal.signal(signal.SIGINT, signal.{before})\n"
        "import gyrofleet\n"
        "os.kill(os.getpid(), signal.SIGINT)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (code, "")


def test_what_asks_for_other_commands_loads_them() -> None:
    """Hints in messages, and the roles of a file of settings."""
    script = (
        "import click, gyrofleet\n"
        "from stream.terminal.hints import _command\n"
        "from analytics.commands.services.config import roles\n"
        "print(_command(gyrofleet.main, ['verify']).name, _command(gyrofleet.main, ['limits', 'add']).name)\n"
        "with click.Context(gyrofleet.main): print(*roles())\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == [
        "verify", "add", "router", "record", "lake", "estimate", "compensate", "serve", "alert", "attest", "replicate",
    ]  # fmt: skip
