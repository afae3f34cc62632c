"""Every long-running role ends on SIGTERM with code 0: what arrived is kept, locks are free, the store is sound."""

import os
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.store import Store, writer_endpoint
from tests.e2e.conftest import Bench, finish

RECORDER = ("record", "--store", "S", "--listen", "ENDPOINT", "--json")
SOURCE = (
    "run-simulated", "--run", "r1", "--simulate", "2", "--hours", "1", "--rate-hz", "50", "--batch", "10",
    "--store", "S",
)  # fmt: skip


RUN = ("run", "scale_factor", "--station", "bench/station.toml", "--units", "bench/units.csv", "--yes", "--store", "S",
       "--json")  # fmt: skip
IMPORT = ("import", "long.parquet", "--unit", "U2", "--run", "r2", "--store", "S", "--listen", "ENDPOINT")
ROWS = 3_000_000


class Case(NamedTuple):
    """A role: what has to be at work before, its words, and what it says once it is at work."""

    words: tuple[str, ...]
    ready: str
    before: tuple[tuple[str, ...], ...] = ()
    is_on_store: bool = True
    code: int = 0  # 130: the same command resumes


CASES = {
    "record": Case(RECORDER, '"event":"recording"', ()),
    "router": Case(("router", "--listen", "ENDPOINT", "--json"), '"event":"routing"', is_on_store=False),
    "estimate": Case(("estimate", "--store", "S", "--connect", "ENDPOINT"), "estimating what arrives", (RECORDER,)),
    "compensate": Case(("compensate", "--store", "S", "--connect", "ENDPOINT"), "compensating what", (RECORDER,)),
    "lake": Case(("lake", "--store", "S", "--json"), '"event":"building"'),
    "serve": Case(("serve", "--store", "S", "--port", "0", "--json"), '"event":"ready"'),
    "replicate": Case(("replicate", "--from", "S", "--to", "F", "--plant", "p", "--watch", "--json"), '"is_well"'),
    "replicate_serve": Case(("replicate", "--serve", "--store", "S", "--listen", "ENDPOINT", "--json"), '"serving"'),
    "alert": Case(("alert", "run", "--store", "S", "--rules", "rules.toml", "--json"), '"event":"watching"'),
    "attest": Case(("attest", "--store", "S", "--key", "key.pem", "--every-h", "1", "--json"), '"attestation"'),
    "run_simulated": Case(SOURCE, "S/log", code=130),
    "run": Case(RUN, '"event":"running"', code=130),
    "import_listen": Case(IMPORT, "S/log", code=130),
    "supervise": Case(("supervise", "roles.toml"), "recording from"),
}


@pytest.fixture
def station(request: pytest.FixtureRequest, tmp_path: Path, simulated: Callable[..., Bench]) -> Iterator[None]:
    """A simulated station, where the role is one that needs it."""
    if request.node.callspec.params["name"] != "run":
        yield
        return
    bench = simulated(tmp_path / "bench", "--speed", 100, "--rate-hz", 10)
    yield
    finish(bench)


@pytest.fixture
def folder(tmp_path: Path, gyrofleet: Callable[..., Any], endpoint: str) -> Path:
    """A store with a segment, and the files that some roles read."""
    table = pa.table({"time[s]": np.arange(ROWS) / 1000.0, "rate[deg/s]": np.sin(np.arange(ROWS))})
    pq.write_table(table, tmp_path / "long.parquet")
    (tmp_path / "a.csv").write_text("time[s],rate[deg/s]\n" + "".join(f"{i / 10},{i % 3}\n" for i in range(200)))
    done = gyrofleet("import", "a.csv", "--unit", "U1", "--run", "r0", "--store", "S")
    assert done.code == 0, done.err
    (tmp_path / "rules.toml").write_text('[[rules]]\nname = "disk"\nkind = "disk"\n')
    (tmp_path / "roles.toml").write_text(f'store = "S"\n[record]\nlisten = "{endpoint}"\n')
    return tmp_path


@pytest.mark.in_gate("record")
@pytest.mark.parametrize("name", CASES)
@pytest.mark.usefixtures("station")
def test_a_role_ends_well_when_it_is_asked_to(
    name: str, folder: Path, spawn: Callable[..., subprocess.Popen[str]], gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    case = CASES[name]
    for words in case.before:
        _at_work(spawn(*_placed(words, endpoint)), '"event":"recording"')
    process = spawn(*_placed(case.words, endpoint))
    _at_work(process, case.ready, folder)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert process.returncode == case.code, (out, err)
    assert "Traceback" not in err, err
    if case.is_on_store and not case.before:
        assert writer_endpoint(Store.open(folder / "S").folder) is None
        assert gyrofleet("verify", "--store", "S").code == 0
    if name == "import_listen":
        assert gyrofleet(*_placed(case.words, endpoint)).code == 0
        rows = gyrofleet(
            "sql", "select count(*)::int as n from samples where run = 'r2'", "--store", "S", "--json"
        ).json
        assert rows == [{"n": ROWS}]


def _placed(words: tuple[str, ...], endpoint: str) -> list[str]:
    return [endpoint if word == "ENDPOINT" else word for word in words]


def _at_work(process: subprocess.Popen[str], ready: str, folder: Path | None = None) -> None:
    """Wait until a role says on either output that it is at work; one that says nothing, until its store grows."""
    assert process.stdout is not None
    assert process.stderr is not None
    if ready == "S/log":
        assert folder is not None
        until = time.monotonic() + 60.0
        while not list((folder / "S/log").glob("*.open")) and time.monotonic() < until:
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        return
    seen = ""
    until = time.monotonic() + 60.0
    while ready not in seen:
        assert time.monotonic() < until, seen
        for stream in select.select([process.stdout, process.stderr], [], [], 1.0)[0]:
            piece = os.read(stream.fileno(), 65536).decode(errors="replace")
            assert piece or process.poll() is None, f"ended with {process.poll()}: {seen}"
            seen += piece
