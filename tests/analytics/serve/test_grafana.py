"""The requests that Grafana's JSON data source (simpod-json-datasource 0.6) makes, as its documentation shows them."""

from typing import Any

import httpx

from tests.analytics.serve.served_store import RATE_HZ, SPIKE, SPIKE_AT, START_NS


def posted(api: httpx.Client, path: str, body: dict[str, Any]) -> Any:
    answer = api.post(f"/api/grafana{path}", json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()


def query(*targets: dict[str, Any], points: int = 550) -> dict[str, Any]:
    return {
        "panelId": 1,
        "range": {
            "from": "2026-11-21T09:33:44.866Z", "to": "2026-11-21T12:33:44.866Z",
            "raw": {"from": "now-6h", "to": "now"},
        },
        "rangeRaw": {"from": "now-6h", "to": "now"},
        "interval": "30s",
        "intervalMs": 30000,
        "maxDataPoints": points,
        "targets": list(targets),
        "adhocFilters": [],
    }  # fmt: skip


def test_the_connection_is_tested(api: httpx.Client) -> None:
    assert api.get("/api/grafana").status_code == 200
    assert api.get("/api/grafana/", follow_redirects=True).status_code == 200


def test_a_query_is_built_part_by_part(api: httpx.Client) -> None:
    metrics = posted(api, "/metrics", {})
    assert "signal" in {each["value"] for each in metrics}
    units = posted(api, "/metric-payload-options", {"metric": "signal", "payload": {}, "name": "unit"})
    assert {"label": "FOG-0001", "value": "FOG-0001"} in units
    payload = {"unit": "FOG-0001", "run": "run-1"}
    signals = posted(api, "/metric-payload-options", {"metric": "signal", "payload": payload, "name": "signal"})
    assert [each["value"] for each in signals] == ["rate", "temperature"]


def test_a_signal_comes_with_its_spike(api: httpx.Client) -> None:
    payload = {"unit": "FOG-0001", "run": "run-1", "signal": "rate"}
    target = {"target": "signal", "refId": "A", "payload": payload}
    found = {each["target"]: each["datapoints"] for each in posted(api, "/query", query(target, points=20))}
    assert set(found) == {"FOG-0001 rate min", "FOG-0001 rate max", "FOG-0001 rate mean"}
    value, t_ms = max(found["FOG-0001 rate max"])
    assert value == SPIKE
    spike_ms = START_NS // 10**6 + SPIKE_AT * 1000 // RATE_HZ
    assert 0 <= spike_ms - t_ms < 10 * 60 * 1000


def test_a_signal_may_be_written_in_one_word(api: httpx.Client) -> None:
    found = posted(api, "/query", query({"target": "FOG-0003/run-2/temperature", "refId": "B"}))
    assert [each["target"] for each in found] == [f"FOG-0003 temperature {name}" for name in ("min", "max", "mean")]
    assert found[0]["unit"] == "degC"


def test_a_table_comes_by_sql(api: httpx.Client) -> None:
    payload = {"sql": "select unit, samples from signals where signal = 'rate' and run = 'run-1' order by unit"}
    (found,) = posted(api, "/query", query({"target": "sql", "refId": "A", "payload": payload}))
    assert found["type"] == "table"
    assert found["columns"] == [{"text": "unit", "type": "string"}, {"text": "samples", "type": "number"}]
    assert found["rows"][0] == ["FOG-0001", 60_000]


def test_variables_list_names(api: httpx.Client) -> None:
    body = {
        "payload": {"target": "units"},
        "range": {"from": "2022-02-14T08:09:32.164Z", "to": "2022-02-21T08:09:32.164Z"},
    }
    assert {"__text": "FOG-0001", "__value": "FOG-0001"} in posted(api, "/variable", body)
    assert posted(api, "/tag-keys", {}) == []


def test_a_query_without_a_signal_says_what_to_choose(api: httpx.Client) -> None:
    answer = api.post("/api/grafana/query", json=query({"target": "signal", "refId": "A"}))
    assert answer.status_code == 400
    assert "choose a unit and a signal" in answer.json()["error"]["message"]
    assert posted(api, "/query", query({"target": "", "refId": "A"})) == []


def test_the_infinity_data_source_reads_the_same(api: httpx.Client) -> None:
    # a JSON backend with the root selector `rows`, and a CSV one with ISO times
    assert api.post("/api/sql", json={"sql": "select 1 as one"}).json()["rows"] == [{"one": 1}]
    lines = api.get("/api/signals/FOG-0001/run-1/rate", params={"points": 5, "format": "csv"}).text.splitlines()
    assert lines[1].startswith("2026-11-21T")
