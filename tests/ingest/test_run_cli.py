"""`gyrofleet run` refuses what cannot be meant, and what cannot be reached leaves nothing behind."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from ingest.commands.run import run
from ingest.simulator.station_files import write_station

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path) -> Refused:
    """Why a run is refused; nothing may be left of it in the folder of its store."""
    parent = tmp_path / "stores"
    parent.mkdir()

    def why(*words: object) -> str:
        done = CliRunner().invoke(run, [*map(str, words), "--store", str(parent / "S"), "--json"])
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


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--hours", 2], "--hours: only with --simulate"),
        (["--speed", 0, "--seed", 1], "--speed, --seed: only with --simulate"),  # the default, but given
        (["--site", "plant"], "--site: only with --simulate"),
        (["--procedure", "x"], "--procedure: only with --simulate"),
    ],
)
def test_a_procedure_refuses_what_is_for_simulated_units(
    refused: Refused, at_station: tuple[object, ...], more: list[object], named: str
) -> None:
    message = refused("static_bias", *at_station, *more)
    assert named in message
    assert "gyrofleet procedure show static_bias" in message


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--units", "units.csv"], "--units: only for a procedure"),
        (["--yes", "--set", "a=1"], "--set, --yes: only for a procedure"),
        (["--settle-timeout-h", 6.0], "--settle-timeout-h: only for a procedure"),
        (["--every", 60], "--every: only for a procedure"),
    ],
)
def test_simulated_units_refuse_what_is_for_procedures(refused: Refused, more: list[object], named: str) -> None:
    assert named in refused(*SIMULATE, *more)


def test_a_name_that_is_nearly_one_is_guessed(refused: Refused, at_station: tuple[object, ...]) -> None:
    assert "no procedure 'scale_facter', did you mean scale_factor?" in refused("scale_facter", *at_station)
    assert "no procedure 'zzz'; `gyrofleet procedure list`" in refused("zzz", *at_station)


def test_instruments_that_cannot_be_reached_leave_no_store_behind(
    refused: Refused, at_station: tuple[object, ...]
) -> None:
    assert "cannot be reached" in refused("static_bias", *at_station)


def test_a_recorder_that_cannot_be_reached_leaves_no_spool_behind(refused: Refused, endpoint: str) -> None:
    assert f"cannot connect to {endpoint}" in refused(*SIMULATE, "--connect", endpoint)


def test_a_moment_that_is_none_leaves_no_store_behind(refused: Refused) -> None:
    assert "'noon' is not a moment" in refused(*SIMULATE, "--start", "noon")


def test_the_help_says_that_a_run_can_be_paused_with_yes_too() -> None:
    text = " ".join(CliRunner().invoke(run, ["--help"]).output.split())
    assert "At a terminal, with --yes too, p Enter pauses" in text
