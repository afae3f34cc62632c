"""The page of a run in a real browser while a station carries it out."""

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from storage.recording.run_command import is_at_work
from storage.store import Store
from tests.analytics.serve.conftest import TOKEN, Served, start
from tests.browser import IS_THERE, Browser
from tests.forked_commands import CommandServer

pytestmark = pytest.mark.skipif(not IS_THERE, reason="chromium and chromedriver are not installed")
Bench = Any
Spawn = Callable[..., "subprocess.Popen[str]"]
State = Callable[[Callable[[dict[str, Any]], bool]], dict[str, Any]]

AXE = Path(__file__).parents[2] / "vendor" / "axe.min.js"
SHORT = ("--set", "startup_s=60", "--set", "rate_record_s=400", "--set", "off_between_rates_s=1", "--every", 20)
SPECIFICATION = """
name = "fog"
revision = "A"
[[limit]]
metric = "allan_deviation"
parameters = { tau_s = 10 }
upper = 2.0
unit_of_measure = "deg/h"
"""


@pytest.fixture
def served(
    tmp_path: Path, store: Path, command_server: CommandServer, gyrofleet: Callable[..., Any]
) -> Iterator[Served]:
    """A server over the store of this test's runs, in a process of its own."""
    Store.create(store)
    (tmp_path / "fog.toml").write_text(SPECIFICATION)
    assert gyrofleet("limits", "add", "fog.toml", "--store", "S").code == 0
    process, ready = start(
        command_server, "--store", "S", "--port", 0, "--token", TOKEN, "--token-role", "operator", cwd=tmp_path
    )
    yield Served(ready["url"], tmp_path, {})
    process.terminate()
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert "Traceback" not in err, err


@pytest.fixture
def window(served: Served) -> Iterator[Browser]:
    with Browser() as browser:
        browser.open(f"{served.url}/login?token={TOKEN}")
        yield browser


def until(look: Callable[[], Any], timeout_s: float = 90.0, trouble: Callable[[], object] = lambda: None) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (found := look()):
        assert time.monotonic() < deadline, trouble()
        time.sleep(0.1)
    return found


def begun(store: Path, state: State, has_come: Callable[[dict[str, Any]], bool]) -> str:
    run: str = state(has_come)["run"]
    until(lambda: is_at_work(store, run))
    return run


def text(window: Browser, selector: str) -> str:
    return str(window.ask(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''"))


@pytest.mark.long
def test_a_run_is_followed_and_commanded_on_its_page(
    served: Served, store: Path, bench: Bench, spawn: Spawn, state: State, window: Browser
) -> None:
    window.open(served.url)
    assert "No run is on the floor" in text(window, "#floor-stations")
    process = spawn(*bench.run("scale_factor", *SHORT))
    run = begun(store, state, lambda found: found["step"] >= 3 and bool(found["open_steps"]))
    with served.program() as client:
        until(lambda: client.get(f"/api/runs/{run}/course").json().get("measured"))
        units = {each["unit"]: each["is_instrument"] for each in client.get(f"/api/runs/{run}").json()["units"]}
        tested = {unit for unit, is_instrument in units.items() if not is_instrument}
        assert tested == {unit for unit in units if unit.startswith("SIM-")}
        assert {"chamber", "table"} <= units.keys() - tested
        assert sum(client.get(f"/api/runs/{run}").json()["verdicts"].values()) == len(tested)
        assert {each["unit"] for each in client.get("/api/units").json()["units"]} == tested
        every = client.get("/api/units", params={"instruments": "true"}).json()["units"]
        assert {each["unit"] for each in every} == units.keys()
        assert {row[1] for row in client.get("/api/floor").json()["units"]} == tested
    # without being loaded again, the floor has the run and its units
    until(lambda: run in text(window, "#floor-stations") and "SIM-0001" in text(window, "#floor-table"))
    assert window.complaints() == []
    window.open(f"{served.url}/runs/{run}")
    for panel in ("rate", "temperature"):
        until(partial(window.ask, f"!!document.querySelector('#time-line-{panel} canvas')"))
    legend = text(window, "#time-line-rate .u-legend")
    assert "commanded" in legend
    assert "table table_rate" in legend
    current = "document.querySelectorAll('#run-steps tr[aria-current=step]').length"
    until(lambda: window.ask(current) == 1)
    plot = "document.querySelector('#time-line-rate .plot')"
    window.ask(f"{plot}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'End'}}))")
    assert "commanded" in until(lambda: text(window, "#time-line-rate .reading"))
    rows = window.ask("document.querySelectorAll('#run-steps tbody tr').length")
    until(lambda: window.ask("document.querySelectorAll('#run-steps tbody tr').length") > rows)  # it is followed

    def press(action: str, reason: str) -> str:
        window.ask("document.getElementById('command-answer').textContent = ''")
        window.ask(f"document.querySelector('#run-control input[name=reason]').value = {json.dumps(reason)}")
        window.ask(f"document.querySelector('#run-control button[value={action}]').click()")
        until(lambda: text(window, "#command-answer") not in {"", "waiting for the station"})
        return text(window, "#command-answer")

    assert "paused at step" in press("pause", "door open")
    until(lambda: "door open" in text(window, "#run-commands"))
    until(lambda: text(window, "#run-progress").startswith("paused"))
    assert "it is paused already" in press("pause", "again")
    assert "goes on at step" in press("resume", "door shut")
    answer = press("abort", "smoke")
    assert "aborted" in answer
    bench.ended(process, code=1)
    assert bench.is_safe()
    until(lambda: "The run has ended: aborted." in text(window, "#run-progress"))
    assert [each for each in window.complaints() if "409" not in each] == []


@pytest.mark.long
def test_the_allan_deviation_of_chosen_units_is_followed_with_its_limit(
    served: Served, store: Path, bench: Bench, spawn: Spawn, state: State, window: Browser
) -> None:
    words = ("--set", "warm_up_s=10", "--set", "bias_record_s=100000", "--every", 20)
    process = spawn(*bench.run("static_bias", *words))
    run = begun(store, state, lambda found: bool(found["open_steps"]))
    with served.program() as client:
        until(lambda: client.get(f"/api/runs/{run}/allan").json().get("units"))
        chosen = client.get(f"/api/runs/{run}/allan", params={"unit": "SIM-0002"}).json()
        assert [each["unit"] for each in chosen["units"]] == ["SIM-0002"]
        many = client.get(f"/api/runs/{run}/allan", params={"unit": [f"U{i}" for i in range(9)]})
        assert many.status_code == 400
        assert client.get(f"/api/runs/{run}/allan", params={"unit": "U1"}).status_code == 404
    window.open(f"{served.url}/runs/{run}?show=SIM-0002&lang=zh")
    section = "document.getElementById('run-allan')?.outerHTML"
    until(
        lambda: window.ask("!!document.querySelector('#run-allan canvas')"),
        trouble=lambda: (window.ask(section), window.complaints()),
    )
    checked = "[...document.querySelectorAll('input[name=show]:checked')].map(box => box.value)"
    assert window.ask(checked) == ["SIM-0002"]
    assert text(window, "#run-allan .u-legend").strip() == "SIM-0002"
    samples = int(until(lambda: window.ask("document.getElementById('run-allan').dataset.samples")))
    until(lambda: int(window.ask("document.getElementById('run-allan').dataset.samples")) > samples)  # it is followed
    until(lambda: "低于限值" in text(window, "#allan-limits"))
    assert window.ask("document.getElementById('run-allan').dataset.limits") == "1"
    plot = "document.querySelector('#run-allan .plot')"
    window.ask(f"{plot}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Home'}}))")
    assert "SIM-0002" in until(lambda: text(window, "#run-allan .reading"))
    window.ask(f"(() => {{ {AXE.read_text()}; return 1 }})()")
    window.ask("axe.run(document).then(found => { window.found = found; }) && 1")
    until(lambda: window.ask("!!window.found"))
    assert window.ask("window.found.violations.map(each => [each.id, each.nodes.map(node => node.html)])") == []
    assert window.complaints() == []
    process.kill()
