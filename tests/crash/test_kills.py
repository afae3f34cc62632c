"""Short forms of the trials of killed processes: `python -m tests.crash.kills --kills 200` is the long one."""

from pathlib import Path

import pytest

from tests.crash.killed_station import Shape, start_program
from tests.crash.kills import trial
from tests.forked_commands import CommandServer

# runs of a sixteenth of the samples, and kills five times as often: few runs are enough for all of them
SHORT = Shape(hours=0.15, rate_hz=200.0, kill_s=0.3)


@pytest.mark.parametrize(
    ("kills", "samples", "shape"), [(5, 200_000, SHORT), pytest.param(20, 3_000_000, Shape(), marks=pytest.mark.long)]
)
def test_killed_at_any_moment_every_role_goes_on_and_nothing_is_lost_or_there_twice(
    tmp_path: Path, command_server: CommandServer, kills: int, samples: int, shape: Shape
) -> None:
    # the long form starts the program, so that it is killed in its imports too
    start = command_server.start if shape is SHORT else start_program
    result = trial(tmp_path, kills, 20261121, shape, start)
    assert result["wrong"] == []
    assert (result["kills"], len(result["by_role"])) == (kills, 5)
    assert result["rows"]["samples"] >= samples
    assert result["rows"]["estimates"] >= 10 * kills
    assert result["recovered_segments"] > 0, "the recorder was to be killed at work"
