"""A run that releases units, looked at in a browser's stead while it goes on and when it has ended."""

import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import httpx
import pytest

from tests.e2e.conftest import finish
from tests.e2e.station.test_stop_when_decided import AFTER, PRODUCTS, SPECIFICATION, specify

Bench = Any
Gyrofleet = Callable[..., Any]
Spawn = Callable[..., subprocess.Popen[str]]
ZONE = "Asia/Shanghai"
TOKEN = "T-of-the-test"
TIME = re.compile(r'<time datetime="([^"]+)">([^<]+) <span class="zone">([^<]+)</span>')


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """A station in Shanghai with two good and two bad units, fifty times real time."""
    folder = tmp_path_factory.mktemp("released") / "sim"
    folder.mkdir()
    rows = [f"{unit},S{i},{product}\n" for i, (unit, product) in enumerate(PRODUCTS.items(), 1)]
    (folder / "units.csv").write_text("serial,slot,product\n" + "".join(rows))
    found = simulated(folder, "--units", 4, "--speed", 50, "--rate-hz", 10)
    file = folder / "station.toml"
    file.write_text(file.read_text().replace('time_zone = "UTC"', f'time_zone = "{ZONE}"'))
    yield found
    finish(found)


@pytest.mark.long
def test_released_units_are_on_the_pages(gyrofleet: Gyrofleet, bench: Bench, spawn: Spawn, tmp_path: Path) -> None:
    specify(gyrofleet, tmp_path, SPECIFICATION + AFTER)
    server = spawn("serve", "--store", "S", "--port", "0", "--token", TOKEN, "--json")
    assert server.stdout is not None
    url = json.loads(server.stdout.readline())["url"]
    short = ("--set", "warm_up_s=30", "--set", "bias_record_s=900", "--every", 20)
    run = spawn(*bench.run("static_bias", *short, "--stop-when-decided"))
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with httpx.Client(base_url=url, headers=headers, timeout=60.0) as client:
        released: dict[str, int] = {}
        while len(released) < 2:
            assert run.poll() is None, run.communicate()
            time.sleep(0.2)
            floor = client.get("/api/floor").json()
            states = [dict(zip(floor["state_columns"], each, strict=True)) for each in floor["states"]]
            released = {each["number"]: each["verdict"] for each in states if each["released"]}
        units = {unit[0]: unit[1] for unit in floor["units"]}
        verdicts = {units[number]: floor["verdicts"][code] for number, code in released.items()}
        assert verdicts == {"SIM-0002": "FAIL", "SIM-0004": "FAIL"}
        (on_floor,) = floor["runs"]
        assert (on_floor["released"], on_floor["time_zone"]) == (2, ZONE)
        for lang, word in (("en", "<td>released</td>"), ("zh", "<td>已提前结束</td>")):
            shown = client.get("/", params={"released": "1", "lang": lang}, headers={"Accept": "text/html"}).text
            assert shown.count(word) == 2
            assert "SIM-0001" not in shown
        name = on_floor["run"]
        time.sleep(2.0)  # the floor is told at once, rows of runs within this time
        going_on = client.get(f"/api/runs/{name}").json()
        assert going_on["run"]["outcome"] == "open"
        assert going_on["run"]["released"] == 2
        assert {each["unit"]: each["released"] for each in going_on["units"] if each["released"]} == verdicts
        assert set(PRODUCTS) <= {each["unit"] for each in going_on["units"]}
        _, err = run.communicate(timeout=120)
        assert run.returncode == 0, err
        deadline_s = time.monotonic() + 5.0
        while (ended := client.get(f"/api/runs/{name}").json())["run"]["outcome"] == "open":
            assert time.monotonic() < deadline_s
        assert ended["run"]["time_zone"] == ZONE
        assert ended["run"]["saved_s"] == pytest.approx(sum(each["saved_s"] or 0.0 for each in ended["units"]))
        page = client.get(f"/runs/{name}", params={"lang": "en"}, headers={"Accept": "text/html"}).text
        assert "Time of units saved" in page
        times = TIME.findall(page)
        assert times
        for utc, shown, zone in times:
            moment = datetime.strptime(utc[:19], "%Y-%m-%dT%H:%M:%S").replace(tzinfo=UTC)
            assert zone == ZONE
            assert shown == moment.astimezone(ZoneInfo(ZONE)).strftime("%Y-%m-%d %H:%M:%S")
        for path in ("/", "/runs", "/units", "/events", "/units/SIM-0001", f"/signals/SIM-0001/{name}/rate"):
            found = TIME.findall(client.get(path, headers={"Accept": "text/html"}).text)
            assert {zone for _, _, zone in found} == {ZONE}, path
    server.terminate()
    _, err = server.communicate(timeout=30)
    assert "Traceback" not in err, err
