"""A run is taken up only from its own spool."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from ingest.run.live_run import RUN_FILE, RunParameters, begin_run, read_run
from ingest.run_record import write_state
from stream.errors import BadInput

PARAMETERS = RunParameters(
    simulate=1, rate_hz=100.0, batch=10, hours=1.0, speed=1.0, seed=1, site="local", station="simulated"
)


def test_the_spool_of_another_run_is_refused(tmp_path: Path) -> None:
    assert read_run(tmp_path, "r1", PARAMETERS) is None
    state = write_state(tmp_path / RUN_FILE, begin_run("r1", PARAMETERS, 0))
    assert read_run(tmp_path, "r1", PARAMETERS) == state
    with pytest.raises(BadInput, match=r"is the spool of run r1, not of r2: give --spool another folder"):
        read_run(tmp_path, "r2", PARAMETERS)
    with pytest.raises(BadInput, match="--seed was 1, now 2"):
        read_run(tmp_path, "r1", msgspec.structs.replace(PARAMETERS, seed=2))


def test_a_run_whose_folder_could_not_be_made_is_refused(gyrofleet: Callable[..., Any]) -> None:
    refused = gyrofleet(
        "run-simulated", "--run", "\u9640" * 67, "--simulate", 1, "--hours", 0.01, "--speed", 0, "--json"
    )
    assert refused.code == 1
    assert "has 201 bytes in UTF-8" in refused.json["error"]["message"]
    assert "--spool FOLDER" in refused.json["error"]["message"]
