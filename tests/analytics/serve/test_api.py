"""The resources of the API: the same figures as those of the commands, pages, kept answers, the OpenAPI document."""

import re
import time
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from tests.analytics.serve.conftest import Served
from tests.analytics.serve.served_store import HOSTILE

Run = Callable[..., Any]


def got(api: httpx.Client, path: str, **parameters: Any) -> Any:
    answer = api.get(path, params=parameters or None)
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.mark.long
def test_units_come_by_name_in_pages(api: httpx.Client) -> None:
    whole = got(api, "/api/units")
    names = [each["unit"] for each in whole["units"]]
    assert names == sorted([*HOSTILE, "FOG-0001", "FOG-0002", "FOG-0003"])
    assert (whole["count"], whole["next"]) == (len(names), None)
    page, seen = got(api, "/api/units", limit=3), []
    while True:
        assert page["count"] == len(names)
        seen += [each["unit"] for each in page["units"]]
        if page["next"] is None:
            break
        page = got(api, page["next"])
    assert seen == names


def test_units_are_found_by_a_part_of_the_name(api: httpx.Client) -> None:
    assert [each["unit"] for each in got(api, "/api/units", search="g-0002")["units"]] == ["FOG-0002"]
    assert got(api, "/api/units", lot="none")["count"] == 0


@pytest.mark.long  # in the gate of a smaller store, see test_months_of_files
def test_a_unit_has_the_figures_of_the_commands(api: httpx.Client, served: Served, run_command: Run) -> None:
    found = got(api, "/api/units/FOG-0001")
    told = run_command("metrics", "--unit", "FOG-0001", "--store", "S", "--json", cwd=served.folder).json
    keys = ("metric", "signal", "run", "value", "lo", "hi", "unit_of_measure", "reason")
    assert [{key: row[key] for key in keys} for row in found["metrics"]] == [
        {key: row[key] for key in keys} for row in told
    ]
    assert found["verdict"]["verdict"] in ("PASS", "FAIL", "MARGINAL")
    assert {row["metric"] for row in found["verdicts"]} == {"bias"}
    assert [each["run"] for each in found["runs"]] in (["run-1", "run-2"], ["run-2", "run-1"])


@pytest.mark.long
def test_verdicts_are_those_of_the_command(api: httpx.Client, served: Served, run_command: Run) -> None:
    found = got(api, "/api/units/FOG-0001")
    told = run_command("verdicts", "--unit", "FOG-0001", "--store", "S", "--json", cwd=served.folder).json
    assert found["verdict"]["verdict"] == told["units"][0]["verdict"]
    assert [row["verdict"] for row in found["verdicts"]] == [row["verdict"] for row in told["verdicts"]]


@pytest.mark.long
def test_a_trend_is_that_of_the_command(api: httpx.Client, served: Served, run_command: Run) -> None:
    told = run_command("trend", "bias", "--by", "unit", "--store", "S", "--json", cwd=served.folder).json
    assert got(api, "/api/trends", metric="bias", by="unit") == told | {"reason": None}


def test_a_trend_without_values_says_why(api: httpx.Client) -> None:
    found = got(api, "/api/trends", metric="bandwidth")
    assert (found["values"], found["charts"]) == (0, [])
    assert "bandwidth" in found["reason"]


@pytest.mark.long
def test_an_allan_curve_is_that_of_the_command(api: httpx.Client, served: Served, run_command: Run) -> None:
    found = got(api, "/api/allan/FOG-0001/run-1/rate", source="samples")
    told = run_command(
        "allan", "--unit", "FOG-0001", "--signal", "rate", "--run", "run-1", "--store", "S", "--json", cwd=served.folder
    ).json
    assert (found["tau_s"], found["adev"], found["lo"], found["hi"]) == (
        told["tau_s"], told["value"], told["lo"], told["hi"],
    )  # fmt: skip
    assert found["unit_of_measure"] == told["unit_of_measure"]


def test_too_few_samples_for_a_curve_are_a_reason(api: httpx.Client) -> None:
    path = f"/api/allan/{HOSTILE[0]}/{HOSTILE[0]}/temperature"
    found = got(api, path)
    assert found["reason"] or found["tau_s"]


def test_a_run_has_its_steps_units_and_course(api: httpx.Client) -> None:
    found = got(api, "/api/runs/run-1")
    assert found["run"]["started"] == "2026-11-21T10:00:00Z"
    assert found["run"]["started_ns"] == 1_795_255_200 * 10**9
    assert [each["unit"] for each in found["units"]] == ["FOG-0001", "FOG-0002", "FOG-0003"]
    assert [(each["repeat"], each["units"]) for each in found["steps"]] == [(1, 3), (2, 3), (3, 3), (4, 3)]
    assert {"RunStarted", "RunEnded"} <= {each["kind"] for each in found["documents"]}
    assert found["verdicts"] == {"OPEN": 3}


def test_the_note_on_an_import_has_the_time_of_the_import(api: httpx.Client) -> None:
    note = next(each for each in got(api, "/api/runs/run-1/course")["notes"] if each["author"] == "import")
    assert abs(time.time_ns() - note["t_ns"]) < 3600 * 10**9, "and not that of the last sample"


def test_a_run_says_which_of_its_units_are_excluded_and_why(api: httpx.Client) -> None:
    name = quote(HOSTILE[3], safe="")
    (unit,) = got(api, f"/api/runs/{name}")["units"]
    assert unit["excluded"] == "<b>kicked</b> (Li)"
    page = api.get(f"/runs/{name}").text
    assert "excluded from evaluation: &lt;b&gt;kicked&lt;/b&gt; (Li)" in page
    of_unit = api.get(f"/units/{quote(str(unit['unit']), safe='')}").text
    assert "excluded from evaluation: &lt;b&gt;kicked&lt;/b&gt; (Li)" in of_unit
    assert "of 1 units excluded from evaluation" in api.get("/runs").text
    assert {each["run"]: each["excluded"] for each in got(api, "/api/runs")["runs"]}["run-1"] == 0
    assert all(each["excluded"] is None for each in got(api, "/api/runs/run-1")["units"])


def test_an_approver_excludes_a_run_over_http_and_a_viewer_does_not(api: httpx.Client, served: Served) -> None:
    asked = {"run": HOSTILE[2], "reason": "wrong axis", "action": "excluded"}
    for role, code in (("engineer", 403), ("approver", 200)):
        headers = {"Authorization": f"Bearer {served.tokens[role]}"}
        answer = httpx.post(f"{served.url}/api/exclusions", json=asked, headers=headers)
        assert answer.status_code == code, answer.text
    (document,) = answer.json()["documents"]
    assert (document["by"], document["identity"]) == ("approver-program", "user:approver-program")
    (unit,) = got(api, f"/api/runs/{quote(HOSTILE[2], safe='')}")["units"]
    assert unit["excluded"] == "wrong axis (approver-program)"
    again = api.post("/api/exclusions", json=asked | {"action": "included"}).json()
    assert (again["units"], again["already"]) == ([HOSTILE[2]], [])
    assert api.post("/api/exclusions", json=asked | {"check": "x"}).status_code == 400
    assert api.post("/api/exclusions", json=asked | {"run": "nix"}).status_code == 404


def test_the_page_of_a_run_has_a_form_that_excludes_units_of_it(served: Served) -> None:
    name = HOSTILE[1]
    page = f"/runs/{quote(name, safe='')}"
    with served.browser("eva") as engineer:
        assert "/act/enter_exclusion" not in engineer.get(page).text
    with served.browser("anna") as approver:
        assert '<select name="units" multiple' in approver.get(page).text
        form = {"csrf": approver.csrf, "back": page, "run": name, "units": ["", name], "reason": "kicked by hand"}
        for action, is_excluded in (("excluded", True), ("included", False)):
            shown = approver.post("/act/enter_exclusion", data=form | {"action": action})
            assert shown.status_code == 200, shown.text
            assert ("excluded from evaluation: kicked by hand (anna)" in shown.text) is is_excluded
        asked = "select document->>'$.unit' as unit from events where kind = 'ExclusionEntered' and run = ?"
        rows = approver.post(
            "/api/sql", json={"sql": asked.replace("?", f"'{name}'")}, headers={"X-CSRF-Token": approver.csrf}
        )
        assert rows.json()["rows"] == [{"unit": name}] * 2  # the chosen unit, not the whole run
        strange = approver.post("/act/enter_exclusion", data=form | {"action": "excluded", "units": "nobody"})
        assert strange.status_code == 404


def test_runs_come_in_pages_without_loss(api: httpx.Client) -> None:
    whole = [each["run"] for each in got(api, "/api/runs")["runs"]]
    assert sorted(whole) == sorted([*HOSTILE, "run-1", "run-2"])
    page, seen = got(api, "/api/runs", limit=2), []
    while True:
        seen += [each["run"] for each in page["runs"]]
        if page["next"] is None:
            break
        page = got(api, page["next"])
    assert seen == whole


def test_events_come_in_pages_with_filters(api: httpx.Client) -> None:
    whole = got(api, "/api/events", limit=10_000)
    last = whole["events"][0]["arrival_ns"]  # tests beside this one enter notes
    page, seen = got(api, "/api/events", limit=7, to=last + 1), []
    while True:
        seen += [each["uid"] for each in page["events"]]
        if page["next"] is None:
            break
        page = got(api, page["next"])
    assert seen == [each["uid"] for each in whole["events"]]
    assert sum(whole["kinds"].values()) >= len(seen)
    steps = got(api, "/api/events", kind="StepStarted", unit="FOG-0002", run="run-2")["events"]
    assert [(each["kind"], each["unit"], each["run"]) for each in steps] == [("StepStarted", "FOG-0002", "run-2")] * 4
    assert got(api, "/api/events", **{"from": last + 3600 * 10**9})["events"] == []


def test_the_store_says_what_it_has(api: httpx.Client, served: Served) -> None:
    until = time.monotonic() + 30.0
    # what other tests entered comes to the lake a little later
    while (found := got(api, "/api/store"))["lake"]["behind"] and time.monotonic() < until:
        time.sleep(0.2)
    assert found["log"]["samples"] == found["lake"]["samples"] > 700_000
    assert found["disk"]["free_bytes"] > 0
    assert found["lake"]["behind"] == []
    assert str(served.folder) not in str(found)


def test_what_is_at_work_and_alerts(api: httpx.Client, served: Served, run_command: Run) -> None:
    found = got(api, "/api/status")
    (serve,) = (each for each in found["roles"] if each["status"]["role"] == "serve")
    assert serve["condition"] == "working"
    told = run_command("status", "--store", "S", "--json", cwd=served.folder).json
    assert "serve" in {each["status"]["role"] for each in told["roles"]}
    assert api.post("/api/alerts/none/acknowledge", json={}).status_code == 404


def test_yield_and_verdicts(api: httpx.Client) -> None:
    assert got(api, "/api/yield", by="station")["by"] == "station"
    verdicts = got(api, "/api/verdicts", limit=2)
    assert verdicts["after"] == verdicts["units"][-1]["unit"]
    names = [each["unit"] for each in verdicts["units"]]
    while verdicts["next"] is not None:
        verdicts = got(api, verdicts["next"])
        names += [each["unit"] for each in verdicts["units"]]
    assert names == [each["unit"] for each in got(api, "/api/verdicts")["units"]]


@pytest.mark.parametrize("by", ["station", "day"])
def test_units_of_a_group_are_those_that_its_yield_counts(api: httpx.Client, by: str) -> None:
    groups = [each for each in got(api, "/api/yield", by=by)["groups"] if each["name"]]
    for group in groups:
        listed = got(api, "/api/verdicts", **{by: group["name"]}, limit=1000)["units"]
        verdicts = [each["verdict"] for each in listed]
        assert len(verdicts) == group["units"], group["name"]
        counts = [group[name] for name in ("passed", "failed", "marginal", "no_data")]
        assert [verdicts.count(name) for name in ("PASS", "FAIL", "MARGINAL", "NO_DATA")] == counts, group["name"]
    assert groups


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/api/units?verdict=BAD", "verdict"), ("/api/verdicts?verdict=PAS", "verdict"),
        ("/api/verdicts?day=29.03.2026", "2026-03-29"), ("/api/verdicts?day=2026-13-45", "2026-03-29"),
        ("/api/verdicts?metric=bais", "bias"), ("/api/events?kind=nope", "RunStarted"),
        ("/api/events?from=2026-11-22T00:00:00Z&to=2026-11-21T00:00:00Z", "before it begins"),
        ("/api/yield?by=lot&name=nope", "no lot is named"), ("/api/trends/chart?metric=bias&chart=99", "from 0 on"),
    ],
)  # fmt: skip
def test_what_can_match_nothing_is_refused(api: httpx.Client, path: str, word: str) -> None:
    answer = api.get(path)
    assert answer.status_code in {400, 404}
    assert word in answer.json()["error"]["message"]
    metrics = {each["metric"]: each for each in got(api, "/api/metrics")["metrics"]}
    assert metrics["bias"]["zh"] == "零偏"
    assert metrics["bias"]["values"] > 0


def test_an_answer_is_kept_until_the_lake_changes(api: httpx.Client) -> None:
    first = api.get("/api/units")
    again = api.get("/api/units", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert first.headers["cache-control"] == "private, no-cache"
    other = api.get("/api/units", headers={"Accept": "application/vnd.apache.arrow.stream"})
    assert other.headers["etag"] != first.headers["etag"]


def test_a_form_that_is_not_there_is_named(api: httpx.Client) -> None:
    answer = api.get("/api/units", headers={"Accept": "application/xml"})
    assert answer.status_code == 406
    assert "application/vnd.apache.arrow.stream" in answer.json()["error"]["message"]


@pytest.mark.parametrize(("path", "word"), [("/api/units/FOG-0O01", "FOG-0001"), ("/api/runs/run1", "run-1")])
def test_a_mistyped_name_is_answered_with_the_nearest(api: httpx.Client, path: str, word: str) -> None:
    answer = api.get(path)
    assert answer.status_code == 404
    assert word in answer.json()["error"]["message"]


def test_the_document_describes_every_route(api: httpx.Client) -> None:
    from analytics.serve.api.routes import OPERATIONS

    document = got(api, "/api/openapi.json")
    described = {(path, method.upper()) for path, each in document["paths"].items() for method in each}
    others = {("/api/live", "GET"), ("/api/me", "GET")}
    assert described == {(each.path.replace(":path}", "}"), each.method) for each in OPERATIONS} | others
    for path, methods in document["paths"].items():
        for operation in methods.values():
            in_path = {each["name"] for each in operation["parameters"] if each["in"] == "path"}
            assert in_path == set(re.findall(r"\{(\w+)\}", path))
            assert operation["summary"].endswith(".")
            assert "401" in operation["responses"]
    references = set(re.findall(r'"#/components/schemas/([^"]+)"', api.get("/api/openapi.json").text))
    assert references <= set(document["components"]["schemas"])


@pytest.mark.parametrize("method", ["DELETE", "PUT", "PATCH", "TRACE"])
def test_other_methods_are_refused(api: httpx.Client, method: str) -> None:
    answer = api.request(method, "/api/units")
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]


def test_figures_for_prometheus(api: httpx.Client, served: Served) -> None:
    text = api.get("/metrics").text
    assert re.search(r"^gyrofleet_serve_lake_samples\{.*\} \d", text, re.MULTILINE)
    assert "FOG" not in text
    with served.nobody() as client:  # the server listens on loopback
        assert client.get("/metrics").status_code == 200
