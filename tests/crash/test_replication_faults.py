"""Short forms of the trial of replication: `python -m tests.crash.replication_faults --faults 100` is the long one."""

from pathlib import Path

import pytest

from tests.crash.replication_faults import FAULTS, start_program, trial
from tests.forked_commands import CommandServer


@pytest.mark.parametrize("faults", [5, pytest.param(100, marks=pytest.mark.long)])
def test_under_faults_each_segment_arrives_once_and_verified(
    tmp_path: Path, command_server: CommandServer, faults: int
) -> None:
    is_short = faults == 5
    start = command_server.start if is_short else start_program
    found = trial(tmp_path, faults, 20261125, start, is_quick=is_short)
    assert found["wrong"] == []
    assert (found["lost"], found["doubled"], found["unverified"]) == (0, 0, 0)
    assert found["samples"] == 40_000 * found["segments"] >= 40_000 * faults
    assert {fault: found["counts"][fault] for fault in FAULTS} == dict.fromkeys(FAULTS, faults // 5)
    assert found["counts"]["struck"] >= 4 * faults // 5
