"""Pictures of the API: the figures that are recorded and planted, in every form; the same groups everywhere."""

import io
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.analytics.serve.conftest import TOKEN, start
from tests.forked_commands import CommandServer

RATE_HZ, STEP_S = 10, 300
UNITS = {"P-1": 0.1, "P-2": 2.0, "P-3": -0.3}  # bias, deg/h
SLOPE = 0.04  # deg/h/degC
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
lower = -60.0
upper = 60.0
unit_of_measure = "arcmin/h"
"""


@pytest.fixture(scope="module")
def pictures(
    tmp_path_factory: pytest.TempPathFactory, command_server: CommandServer, run_command: Callable[..., Any]
) -> Iterator[httpx.Client]:
    """A server over three units on two stations: a ramp of temperature, biases of which one is beyond its limit."""
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "limits.toml").write_text(LIMITS)
    (folder / "units.csv").write_text(
        "serial,product,lot,fixture\n" + "".join(f"{unit},P,L{1 + (unit == 'P-2')},F1\n" for unit in UNITS)
    )
    for number, station in enumerate(("A", "B", "A"), 1):
        pq.write_table(pa.concat_tables(recorded(unit, number) for unit in UNITS), folder / f"{number}.parquet")
        words = (
            "import", f"{number}.parquet", "--start", f"2026-0{number + 5}-01T12:00:00Z", "--station", station,
            "--units", "units.csv", "--store", "S",
        )  # fmt: skip
        done = run_command(*words, cwd=folder)
        assert done.code == 0, (done.out, done.err)
    done = run_command("limits", "add", "limits.toml", "--reason", "first", "--by", "Li", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    process, ready = start(command_server, "--store", "S", "--port", 0, "--token", TOKEN, cwd=folder)
    with httpx.Client(base_url=ready["url"], headers={"Authorization": f"Bearer {TOKEN}"}, timeout=120.0) as client:
        yield client
    process.terminate()
    _, err = process.communicate(timeout=30)
    assert "Traceback" not in err, err


def recorded(unit: str, number: int) -> pa.Table:
    """A static run at 20 degC; the third one ramps from 20 to 40 degC."""
    n = RATE_HZ * STEP_S
    seconds = np.arange(n) / RATE_HZ
    temperature = 20.0 + (20.0 * seconds / STEP_S if number == 3 else 0.0 * seconds)
    noise = np.random.default_rng([number, len(unit), int(unit[-1])]).normal(0.0, 0.3, n)
    return pa.table(
        {
            "time[s]": seconds, "unit": [unit] * n, "run": [f"r{number}"] * n,
            "rate[deg/h]": UNITS[unit] + SLOPE * (temperature - 20.0) + noise, "temperature[degC]": temperature,
            "procedure": ["static_bias"] * n, "repeat": [1] * n, "position": ["IRA_east_west"] * n,
        }
    )  # fmt: skip


def got(client: httpx.Client, path: str, **parameters: Any) -> Any:
    answer = client.get(path, params=parameters or None)
    assert answer.status_code == 200, answer.text
    return answer.json()


def _stream(raw: io.BytesIO) -> pa.Table:
    return pa.ipc.open_stream(raw).read_all()


def curves(picture: Any, style: str) -> list[Any]:
    return [each for each in picture["curves"] if each["style"] == style]


@pytest.mark.long
def test_a_characteristic_over_time_against_its_limits(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/units/P-2/history", metric="bias")
    assert (found["x"]["scale"], found["y"]["unit"]) == ("time", "deg/h")
    values = curves(found, "both")[0]
    assert values["y"][0] == pytest.approx(2.0, abs=0.05)
    assert len(values["x"]) == 3
    assert values["lo"][0] < values["y"][0] < values["hi"][0]
    assert "FAIL" in values["texts"][0]
    assert sorted({y for each in curves(found, "limit") for y in each["y"]}) == [-1.0, 1.0]
    metrics = got(pictures, "/api/units/P-2")["metrics"]
    assert {row["value"] for row in metrics if row["metric"] == "bias"} >= set(values["y"])


def test_kinds_without_a_limit_are_not_drawn_beside_one(pictures: httpx.Client) -> None:
    free = got(pictures, "/api/units/P-2/history", metric="bias_stability_averaged")
    assert curves(free, "limit") == []
    assert len({each["name"]["en"] for each in free["curves"]}) >= 2
    assert free["note"] is None


def test_allan_curves_of_all_runs_in_one_picture(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/units/P-1/allan")
    assert [each["name"]["en"] for each in found["curves"]] == ["r3", "r2", "r1"]
    assert (found["x"]["scale"], found["y"]["scale"], found["y"]["unit"]) == ("log", "log", "deg/h")
    alone = got(pictures, "/api/allan/P-1/r2/rate")
    assert found["curves"][1]["y"] == alone["adev"]
    assert found["curves"][1]["hi"] == alone["hi"]


def test_bias_over_temperature_has_the_planted_slope(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/units/P-1/temperature")
    (ramp,) = (each for each in found["curves"] if each["name"]["en"] == "r3")
    slope, level = np.polyfit(np.array(ramp["x"]) - 20.0, ramp["y"], 1)
    assert slope == pytest.approx(SLOPE, rel=0.1)
    assert level == pytest.approx(UNITS["P-1"], abs=0.05)
    assert (found["x"]["unit"], found["y"]["unit"]) == ("degC", "deg/h")


@pytest.mark.parametrize("form", ["csv", "parquet", "arrow"])
def test_the_data_of_a_picture_come_in_every_form(pictures: httpx.Client, form: str) -> None:
    path = "/api/units/P-1/allan"
    points = sum(len(each["x"]) for each in got(pictures, path)["curves"])
    answer = pictures.get(path, params={"format": form})
    assert answer.status_code == 200
    buffer = io.BytesIO(answer.content)
    read = {
        "csv": pyarrow.csv.read_csv,
        "parquet": pq.read_table,
        "arrow": lambda raw: pa.ipc.open_stream(raw).read_all(),
    }
    table = read[form](buffer)
    assert table.num_rows == points
    assert table.column_names == ["curve", "point", "x", "y", "lo", "hi"]


@pytest.mark.long
def test_every_value_of_a_trend_by_station_and_by_unit(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/trends/values", metric="bias")
    assert [(each["name"]["en"], len(each["x"])) for each in curves(found, "points")] == [("A", 6), ("B", 3)]
    by_unit = got(pictures, "/api/trends/values", metric="bias", by="unit")
    assert [each["name"]["en"] for each in curves(by_unit, "points")] == list(UNITS)
    assert all(each["links"][0].startswith("/units/P-") for each in curves(by_unit, "points"))
    assert [each["y"] for each in curves(found, "limit")] == [[-1.0, -1.0], [1.0, 1.0]]


def test_a_control_chart_has_the_figures_of_the_trend(pictures: httpx.Client) -> None:
    trend = got(pictures, "/api/trends", metric="bias", by="unit")
    for number, chart in enumerate(trend["charts"]):
        found = got(pictures, "/api/trends/chart", metric="bias", by="unit", chart=number)
        assert curves(found, "both")[0]["y"] == [point["charted"] for point in chart["points"]]
        if "centre" in chart["limits"]:
            assert curves(found, "centre")[0]["y"][0] == chart["limits"]["centre"]
    for beyond, code, word in ((99, 404, "from 0 on"), (-1, 400, "chart")):
        answer = pictures.get("/api/trends/chart", params={"metric": "bias", "chart": beyond})
        assert (answer.status_code, word in answer.text) == (code, True)


def test_yield_and_what_a_group_fails_by(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/yield", by="lot")
    assert {row["name"]: row["failed"] for row in found["groups"]} == {"L1": 0, "L2": 1}
    assert [(row["metric"], row["failed"], row["judged"]) for row in found["pareto"]] == [("bias", 1, 3)]
    assert got(pictures, "/api/yield", by="lot", name="L1")["pareto"] == []
    assert [row["judged"] for row in got(pictures, "/api/yield", by="lot", name="L2")["pareto"]] == [1]
    bars = got(pictures, "/api/yield/groups", by="lot")
    assert dict(zip([name["en"] for name in bars["x"]["names"]], bars["curves"][0]["y"], strict=True)) == {
        "L1": 100.0, "L2": 0.0,
    }  # fmt: skip
    pareto = got(pictures, "/api/yield/pareto", by="lot", name="L2")
    assert pareto["curves"][0]["y"] == [100.0]
    assert "verdict=FAIL" in pareto["curves"][0]["links"][0]
    assert got(pictures, "/api/yield/pareto", by="lot", name="L1")["reason"]["zh"] == "没有不合格产品。"


@pytest.mark.parametrize(
    ("asked", "units"),
    [
        ({"verdict": "FAIL"}, ["P-2"]),
        ({"lot": "L1"}, ["P-1", "P-3"]),
        ({"station": "B", "verdict": "FAIL"}, ["P-2"]),
        ({"station": "B", "verdict": "PASS"}, ["P-1", "P-3"]),
        ({"day": "2026-06-01", "metric": "bias", "verdict": "FAIL"}, ["P-2"]),
        ({"fixture": "F9"}, []),
    ],
)
def test_units_behind_a_bar(pictures: httpx.Client, asked: dict[str, str], units: list[str]) -> None:
    assert [row["unit"] for row in got(pictures, "/api/verdicts", **asked)["units"]] == units


def test_the_audit_of_a_unit_says_who_did_what(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/units/P-1/audit")["events"]
    kinds = {each["kind"] for each in found}
    assert {"RunStarted", "RunEnded", "StepStarted"} <= kinds
    assert not kinds & {"EarlyDecision", "NoiseFitted"}
    assert {each["unit"] for each in found} <= {None, "P-1"}
    entered = got(pictures, "/api/events", only="people")["events"]
    assert {each["kind"] for each in entered} == {"SpecificationEntered", "UnitMounted"}
    assert {each["by"] for each in entered if each["kind"] == "SpecificationEntered"} == {"Li"}
    assert got(pictures, "/api/events", by="Nobody")["events"] == []
    pages = got(pictures, "/api/units/P-1/audit", limit=2)
    assert [each["uid"] for each in pages["events"]] == [each["uid"] for each in found[:2]]
    assert got(pictures, pages["next"])["events"][0]["uid"] == found[2]["uid"]


def test_what_was_announced_is_stored(pictures: httpx.Client) -> None:
    found = got(pictures, "/api/store")
    assert [(row["run"], row["missing"]) for row in found["delivery"]] == [("r3", 0), ("r2", 0), ("r1", 0)]
    assert all(row["announced"] == row["recorded"] == 2 * 3 * RATE_HZ * STEP_S for row in found["delivery"])
    assert len(found["segments"]) == found["log"]["segments"]
    assert all(row["is_in_lake"] for row in found["segments"])
    assert any(row["role"] == "serve" for row in found["counters"])


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    "page",
    [
        "/units/P-2?metric=bias_stability_averaged", "/trends?metric=bias&by=unit&yield_by=station",
        "/trends?yield_by=lot&group=L2", "/verdicts?lot=L2&verdict=FAIL", "/signals/P-1/r3/rate?beside=none", "/store",
    ],
)  # fmt: skip
def test_pages_have_their_tables_without_scripts(pictures: httpx.Client, page: str, language: str) -> None:
    answer = pictures.get(f"{page}{'&' if '?' in page else '?'}lang={language}", headers={"Accept": "text/html"})
    assert answer.status_code == 200, answer.text
    assert answer.text.count("<table") >= 1
    for url in {part.split('"')[0] for part in answer.text.split('data-figure="')[1:]}:
        assert got(pictures, url.replace("&amp;", "&"))["curves"]


@pytest.mark.long
def test_a_diagnosis_is_a_page_with_its_pictures(pictures: httpx.Client) -> None:
    job = pictures.post("/api/diagnosis/P-1/jobs", json={"model": "rate = bias"}).json()["job"]["id"]
    while (found := got(pictures, f"/api/jobs/{job}"))["job"]["state"] in ("waiting", "running"):
        pass
    assert found["job"]["state"] == "done", found
    report = found["result"]["reports"]["P-1"]
    for language in ("en", "zh"):
        page = pictures.get(f"/diagnosis/P-1?lang={language}", headers={"Accept": "text/html"})
        assert page.status_code == 200
        assert report[language]["verdict"].split(":")[0][:20] in page.text
    for name, picture in report["pictures"].items():
        assert got(pictures, f"/api/jobs/{job}/picture", name=name)["curves"] == picture["curves"]
    assert pictures.get(f"/api/jobs/{job}/picture", params={"name": "none"}).status_code == 404
