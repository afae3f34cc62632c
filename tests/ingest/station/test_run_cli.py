"""`gyrofleet run` and `run-simulated` refuse what cannot be meant, and what cannot be reached leaves nothing behind."""

import json
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from ingest.commands.run import run, run_simulated
from ingest.simulator.station_files import write_station

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path) -> Refused:
    """Why a run is refused; nothing may be left of it in the folder of its store."""
    parent = tmp_path / "stores"
    parent.mkdir()

    def why(*words: object, command: click.Command = run) -> str:
        done = CliRunner().invoke(command, [*map(str, words), "--store", str(parent / "S"), "--json"])
        assert done.exit_code == 1, done.output
        assert list(parent.iterdir()) == []
        message: str = json.loads(done.output.splitlines()[-1])["error"]["message"]
        return message

    return why


@pytest.fixture
def at_station(tmp_path: Path) -> tuple[object, ...]:
    """The files of a simulated station that nobody plays."""
    folder = tmp_path / "bench"
    folder.mkdir()
    write_station(folder, ["FOG-1"], speed=100.0, rate_hz=10.0, seed=1, now_s=1.8e9)
    (folder / "units.csv").write_text("serial\nFOG-1\n")
    return ("--station", folder / "station.toml", "--units", folder / "units.csv", "--yes")


SIMULATE = ("--run", "r1", "--simulate", 1)


@pytest.mark.parametrize("more", [(), ("--run", "r1", "--hours", 2), ("static_bias",)])
def test_what_simulated_units_need_is_pointed_to_their_command(more: tuple[object, ...]) -> None:
    done = CliRunner().invoke(run, [*map(str, more), "--simulate", "3"])
    assert done.exit_code == 2
    assert "gyrofleet run-simulated --run ID --simulate N" in " ".join(done.output.split())


def test_the_two_commands_share_no_option_that_either_refuses() -> None:
    options = [{name for each in command.params for name in each.opts} for command in (run, run_simulated)]
    common = {
        "--run", "--operator", "--lot", "--store", "--connect", "--spool", "--spool-mb", "--end", "--json", "--station",
        "--status-listen", "--security", "--insecure", "--log-format", "--log-level",
    }  # fmt: skip
    assert options[0] & options[1] == common


@pytest.mark.parametrize("command", [run, run_simulated])
def test_the_help_fits_a_terminal_of_80_columns(command: click.Command) -> None:
    lines = CliRunner().invoke(command, ["--help"], terminal_width=80).output.splitlines()
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 66


@pytest.mark.parametrize("option", ["--hours", "--speed", "--seed", "--site", "--procedure"])
def test_a_procedure_has_no_option_of_simulated_units(at_station: tuple[object, ...], option: str) -> None:
    done = CliRunner().invoke(run, ["static_bias", *map(str, at_station), option, "1"])
    assert done.exit_code == 2
    assert "No such option" in done.output


@pytest.mark.parametrize("option", ["--units", "--yes", "--set", "--settle-timeout-h", "--every", "--specification"])
def test_simulated_units_have_no_option_of_a_procedure(option: str) -> None:
    done = CliRunner().invoke(run_simulated, [*map(str, SIMULATE), option, "1"])
    assert done.exit_code == 2
    assert "No such option" in done.output


def test_a_name_that_is_nearly_one_is_guessed(refused: Refused, at_station: tuple[object, ...]) -> None:
    assert "no procedure 'scale_facter', did you mean scale_factor?" in refused("scale_facter", *at_station)
    assert "no procedure 'zzz'; `gyrofleet procedure list" in refused("zzz", *at_station)


def test_instruments_that_cannot_be_reached_leave_no_store_behind(
    refused: Refused, at_station: tuple[object, ...]
) -> None:
    assert "cannot be reached" in refused("static_bias", *at_station)


@pytest.mark.long
def test_a_recorder_that_cannot_be_reached_leaves_no_spool_behind(refused: Refused, endpoint: str) -> None:
    assert f"cannot connect to {endpoint}" in refused(*SIMULATE, "--connect", endpoint, command=run_simulated)


def test_a_moment_that_is_none_leaves_no_store_behind(refused: Refused) -> None:
    assert "'noon' is not a moment" in refused(*SIMULATE, "--start", "noon", command=run_simulated)


def test_the_help_says_that_a_run_can_be_paused_with_yes_too() -> None:
    text = " ".join(CliRunner().invoke(run, ["--help"]).output.split())
    assert "At a terminal, with --yes too, p Enter pauses" in text
