"""Tables of the API: the same columns and types on every page, and what is asked in ways that clients have."""

import io
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pyarrow as pa
import pytest

from analytics.serve.api.operation import Operation
from analytics.serve.api.routes import OPERATIONS
from tests.analytics.serve.served_store import GAP, HOSTILE, RATE_HZ, START_NS

ARROW = {"Accept": "application/vnd.apache.arrow.stream"}
DT_NS = 10**9 // RATE_HZ
TABLES = [each for each in OPERATIONS if each.table is not None]
PARAMETERS = {"metric": "bias", "unit": "FOG-0001", "signal": "rate", "run": "run-1"}


def arrow(api: httpx.Client, path: str, **parameters: Any) -> pa.Table:
    answer = api.get(path, params=parameters or None, headers=ARROW)
    assert answer.status_code == 200, answer.text
    return pa.ipc.open_stream(io.BytesIO(answer.content)).read_all()


def address(operation: Operation[Any, Any]) -> str:
    of = {"unit": "FOG-0001", "run": "run-1", "signal": "rate"}
    return operation.path.format(**of)


@pytest.mark.parametrize("operation", [each for each in TABLES if "{job}" not in each.path], ids=lambda each: each.name)
def test_a_table_has_columns_with_types(api: httpx.Client, operation: Operation[Any, Any]) -> None:
    fields = operation.asked.__struct_fields__
    needed = {name: value for name, value in PARAMETERS.items() if name == "metric" and name in fields}
    table = arrow(api, address(operation), **needed)
    assert table.num_columns
    assert not [field.name for field in table.schema if pa.types.is_null(field.type)]


@pytest.mark.parametrize("path", ["/api/units", "/api/events", "/api/runs"])
def test_pages_and_empty_lists_join(api: httpx.Client, path: str) -> None:
    first = arrow(api, path, limit=1)
    whole = arrow(api, path, limit=10_000)
    assert first.schema == whole.schema
    none = {"/api/units": {"search": "no such unit"}, "/api/events": {"run": "none"}, "/api/runs": {"search": "none"}}
    empty = arrow(api, path, **none[path])
    assert empty.num_rows == 0
    assert pa.concat_tables([empty, first, whole]).num_rows == 1 + whole.num_rows


def test_verdicts_of_no_unit_have_their_columns(api: httpx.Client) -> None:
    empty, whole = arrow(api, "/api/verdicts", product="none"), arrow(api, "/api/verdicts")
    assert (empty.num_rows, empty.schema) == (0, whole.schema)
    rows = api.get("/api/verdicts").json()["units"]
    assert whole.to_pylist() == [{name: row[name] for name in whole.column_names} for row in rows]
    assert set(whole.column_names) == set(rows[0]), "the type of a row names all of its fields"


def test_the_types_of_rows_name_all_of_their_fields(api: httpx.Client) -> None:
    for path, name, parameters in (
        ("/api/units/FOG-0001", "metrics", {}), ("/api/yield", "groups", {"by": "lot"}), ("/api/store", "clocks", {}),
    ):  # fmt: skip
        row = api.get(path, params=parameters).json()[name][0]
        assert set(arrow(api, path, **parameters).column_names) == set(row)


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        ("application/json;q=0.2, application/vnd.apache.arrow.stream;q=0.9", "arrow"),
        ("text/csv;q=0, */*", "json"),
        ("text/csv, application/json;q=0.5", "csv"),
    ],
)
def test_the_most_wanted_form_comes(api: httpx.Client, accept: str, form: str) -> None:
    assert form in api.get("/api/units", headers={"Accept": accept}).headers["content-type"]


def test_the_head_of_the_stream_ends(api: httpx.Client) -> None:
    answer = api.head("/api/live", timeout=5.0)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/event-stream; charset=utf-8")


@pytest.mark.parametrize(
    ("body", "word"),
    [
        ({"run": "run-1", "text": " \n\t "}, "empty"),
        ({"run": "run-1", "text": "bell \x07"}, "control characters"),
        ({"run": "run-1", "text": "seen", "unit": "FOG-9999"}, "FOG-9999"),
        ({"run": "run-2", "text": "seen", "unit": HOSTILE[2]}, "is not in run"),
    ],
)
def test_a_note_that_says_nothing_or_is_of_another_run_is_refused(
    api: httpx.Client, body: dict[str, str], word: str
) -> None:
    answer = api.post("/api/notes", json=body)
    assert answer.status_code in (400, 404)
    assert word in answer.json()["error"]["message"]


@pytest.mark.parametrize("notes", [4, pytest.param(12, marks=pytest.mark.long)])
def test_notes_of_many_people_at_once_are_all_kept(api: httpx.Client, notes: int) -> None:
    def note(number: int) -> int:
        return api.post("/api/notes", json={"run": "run-1", "text": f"at once {number} of {notes}"}).status_code

    with ThreadPoolExecutor(6) as pool:
        assert set(pool.map(note, range(notes))) == {200}
    kept = {each["document"].get("text") for each in api.get("/api/events?kind=NoteAdded&limit=1000").json()["events"]}
    assert {f"at once {number} of {notes}" for number in range(notes)} <= kept


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/api/runs?after=garbage", "after 'garbage'"),
        ("/api/runs?outcome=finished", "completed"),
        ("/api/runs/run-1?unit=FOG-9999", "FOG-9999"),
        ("/api/units/FOG-0001/history?metric=bias&signal=none", "no signal 'none'"),
        ("/api/trends?metric=bias&since=yesterday", "since 'yesterday'"),
    ],
)
def test_a_filter_that_nothing_can_match_is_refused(api: httpx.Client, path: str, word: str) -> None:
    answer = api.get(path)
    assert answer.status_code in (400, 404), answer.text
    message = answer.json()["error"]["message"]
    assert word in message
    assert "--" not in message


def test_gaps_at_the_ends_of_a_stretch(api: httpx.Client) -> None:
    first, last = START_NS + GAP[0] * DT_NS, START_NS + GAP[1] * DT_NS
    middle = (first + last) // 2
    path = "/api/signals/FOG-0002/run-1/rate"

    def gaps(begin: int, end: int) -> list[list[int]]:
        answer = api.get(path, params={"from": begin, "to": end, "points": 10_000})
        found: list[list[int]] = answer.json()["gaps"]
        return found

    assert gaps(middle, middle + 10 * DT_NS) == [[middle, middle + 10 * DT_NS]]
    assert gaps(middle, last + 10 * DT_NS) == [[middle, last]]
    ((begin, end),) = gaps(first - 10 * DT_NS, middle)
    assert (first - DT_NS <= begin <= first, end) == (True, middle)


def test_a_value_has_one_time(api: httpx.Client) -> None:
    """The history of a unit and the trend of all date a value alike."""
    history = api.get("/api/units/FOG-0001/history", params={"metric": "bias", "signal": "rate"}).json()
    values = api.get("/api/trends/values", params={"metric": "bias", "unit": "FOG-0001", "signal": "rate"}).json()
    moments = [
        {x for curve in found["curves"] if curve["style"] in ("points", "both") for x in curve["x"]}
        for found in (history, values)
    ]
    assert moments[0] >= moments[1] != set()


def test_the_document_knows_every_resource_and_refusal(api: httpx.Client) -> None:
    paths = api.get("/api/openapi.json").json()["paths"]
    assert {"/api/live", "/api/me"} <= set(paths)
    pdf = paths["/api/certificates/{number}/pdf"]["get"]["responses"]["200"]["content"]
    assert list(pdf) == ["application/pdf"]
    assert {"409", "413"} <= set(paths["/api/runs/{run}/commands"]["post"]["responses"])
    assert "406" in paths["/api/units"]["get"]["responses"]
