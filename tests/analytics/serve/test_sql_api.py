"""SQL over HTTP: forms of the result, limits, and statements that would do more than read."""

import io
import time

import httpx
import pyarrow as pa
import pyarrow.parquet as pq
import pytest


def test_rows_are_objects_with_columns_and_types(api: httpx.Client) -> None:
    found = api.post(
        "/api/sql", json={"sql": "select unit, count(*) as n from samples where run = 'run-1' group by unit"}
    )
    rows = found.json()
    assert rows["columns"] == [{"name": "unit", "type": "string"}, {"name": "n", "type": "int64"}]
    assert {"unit": "FOG-0001", "n": 120_000} in rows["rows"]
    assert (rows["count"], rows["truncated"]) == (3, False)


def test_arrays_repeated_names_and_values_that_json_lacks(api: httpx.Client) -> None:
    body = {
        "sql": "select 1 as a, 2 as a, 'nan'::double as b, make_timestamp_ns(1) as t, [1, null] as l, "
        "'\\x01'::blob as d",
        "shape": "arrays",
    }
    rows = api.post("/api/sql", json=body).json()
    assert [each["name"] for each in rows["columns"]] == ["a", "a_2", "b", "t", "l", "d"]
    assert rows["rows"][0][:3] == [1, 2, None]
    assert rows["rows"][0][3].endswith("00:00:00.000000001")


def test_parameters_fill_the_statement(api: httpx.Client) -> None:
    body = {"sql": "select $x as x, $y as y", "parameters": {"x": "O'Brien\";--", "y": 2}}
    assert api.post("/api/sql", json=body).json()["rows"] == [{"x": "O'Brien\";--", "y": 2}]


def test_more_rows_than_asked_are_cut_and_it_says_so(api: httpx.Client) -> None:
    found = api.post("/api/sql", json={"sql": "select * from range(1000)", "rows": 10}).json()
    assert (found["count"], found["truncated"]) == (10, True)
    assert api.post("/api/sql", json={"sql": "select 1 as one"}).json()["rows"] == [{"one": 1}]


@pytest.mark.parametrize("form", ["json", "arrow", "csv", "parquet"])
def test_every_form_says_that_it_is_cut(api: httpx.Client, form: str) -> None:
    for rows, is_cut in ((10, "true"), (1000, "false")):
        body = {"sql": "select * from range(1000)", "rows": rows, "format": form}
        assert api.post("/api/sql", json=body).headers["x-truncated"] == is_cut


@pytest.mark.parametrize("form", ["arrow", "csv", "parquet"])
def test_a_list_as_a_table_has_the_address_of_its_next_page(api: httpx.Client, form: str) -> None:
    following = api.get("/api/units", params={"limit": 1}).json()["next"]
    page = api.get("/api/units", params={"limit": 1, "format": form})
    assert page.headers["link"] == f'<{following}>; rel="next"'
    assert api.get(page.links["next"]["url"]).json()["units"] == api.get(following).json()["units"]
    assert "link" not in api.get("/api/units", params={"format": form}).headers


def test_arrow_parquet_and_csv(api: httpx.Client) -> None:
    body = {"sql": "select 7 as n, '=1+1' as formula, null as nothing"}
    arrow = api.post("/api/sql", json=body, headers={"Accept": "application/vnd.apache.arrow.stream"})
    assert pa.ipc.open_stream(io.BytesIO(arrow.content)).read_all()["n"].to_pylist() == [7]
    parquet = api.post("/api/sql", json=body | {"format": "parquet"})
    assert parquet.headers["content-type"] == "application/vnd.apache.parquet"
    assert pq.read_table(io.BytesIO(parquet.content))["formula"].to_pylist() == ["=1+1"]
    text = api.post("/api/sql", json=body | {"format": "csv"})
    assert text.headers["content-type"].startswith("text/csv")
    assert text.text.splitlines() == ["n,formula,nothing", "7,'=1+1,"]
    apart = {"sql": "select null as a, '' as b, 'nan'::double as c, 'x\"y,' as d, true as e, null::blob as f"}
    assert api.post("/api/sql", json=apart | {"format": "csv"}).text == 'a,b,c,d,e,f\r\n,"",nan,"x""y,",True,\r\n'
    (row,) = api.post("/api/sql", json=apart | {"shape": "shown"}).json()["rows"]
    assert row == [None, "", "NaN", 'x"y,', True, None]


REFUSED = (
    "copy (select 1) to '/tmp/x.csv'",
    "explain analyze copy (select 1) to '/tmp/x.csv'",
    "select * from read_text('/etc/passwd')",
    "from '/etc/passwd'",
    "attach '/tmp/x.db'",
    "install httpfs",
    "create table t as select 1",
    "drop view samples",
    "delete from units",
    "set memory_limit = '100GB'",
    "pragma database_list",
    "select 1; select 2",
    "with gone as (delete from units returning *) select * from gone",
    "select getenv('HOME')",
    "select nonsense from nowhere",
    "",
    "\x00",
    "select '\ud800'",
)


@pytest.mark.parametrize("statement", REFUSED)
def test_what_does_not_only_read_is_refused_with_a_sentence(api: httpx.Client, statement: str) -> None:
    content = b'{"sql": ' + ascii_json(statement) + b"}"
    answer = api.post("/api/sql", content=content)
    assert answer.status_code == 400, answer.text
    message = answer.json()["error"]["message"]
    assert message
    assert "Traceback" not in message
    assert "root:" not in answer.text
    assert "--" not in message, "nobody who asks here has the command's options"


def test_who_would_keep_a_result_learns_how_over_http(api: httpx.Client) -> None:
    message = api.post("/api/sql", json={"sql": "create table t as select 1"}).json()["error"]["message"]
    assert "to keep a result ask for it as a file: `format` csv or parquet" in message


def ascii_json(text: str) -> bytes:
    import json

    return json.dumps(text).encode()


BOMBS = ("select count(*) from range(1000000000000) a, range(1000) b", "select list(i) from range(3000000000) t(i)")


@pytest.mark.long
@pytest.mark.parametrize("statement", [BOMBS[1], pytest.param(BOMBS[0], marks=pytest.mark.long)])
def test_a_bomb_ends_and_harms_nobody(api: httpx.Client, statement: str) -> None:
    began = time.monotonic()
    answer = api.post("/api/sql", json={"sql": statement})
    assert answer.status_code == 400
    message = answer.json()["error"]["message"]
    assert "ask for less: " in message
    assert "--max" not in message
    assert "QueryLimits" not in message
    assert time.monotonic() - began < 50
    assert api.post("/api/sql", json={"sql": "select 1 as one"}).json()["rows"] == [{"one": 1}]


@pytest.mark.parametrize(
    ("content", "status"),
    [(b"{", 400), (b"[]", 400), (b'{"statement": 1}', 400), (b'{"sql": "select 1", "rows": 0}', 400),
     (b'{"sql": "' + b"x" * (1 << 20) + b'"}', 413), (b"[" * 100_000, 400)],
    ids=["cut", "list", "other", "rows", "long", "deep"],
)  # fmt: skip
def test_a_body_that_is_not_right(api: httpx.Client, content: bytes, status: int) -> None:
    answer = api.post("/api/sql", content=content)
    assert answer.status_code == status
    assert answer.json()["error"]["message"]


def test_the_tables_and_examples_work(api: httpx.Client) -> None:
    found = api.get("/api/sql/tables").json()
    assert {"samples", "unit_metrics", "verdicts"} <= {each["table"] for each in found["tables"]}
    assert all(each["columns"] for each in found["tables"])
    assert api.post("/api/sql", json={"sql": found["examples"][0]["sql"]}).status_code == 200


@pytest.mark.long
@pytest.mark.parametrize("columns", ["true", "null"])
@pytest.mark.parametrize("form", ["json", "csv"])
def test_what_is_small_in_arrow_and_huge_as_text_is_refused(api: httpx.Client, columns: str, form: str) -> None:
    """A bit or nothing for each value, until it is written: 300 such columns took 9 GB of the server."""
    statement = f"select {', '.join(f'{columns} as c{number}' for number in range(25))} from range(1000000)"
    answer = api.post("/api/sql", json={"sql": statement, "rows": 1_000_000, "format": form})
    assert answer.status_code == 400
    assert "more than 20,000,000 values" in answer.json()["error"]["message"]


def test_a_long_text_in_a_dictionary_counts_in_each_row(api: httpx.Client) -> None:
    statement = f"select 'b'::enum('{'x' * 500_000}', 'b') as e from range(100000)"
    answer = api.post("/api/sql", json={"sql": statement, "rows": 100_000})
    assert answer.status_code == 400
    assert "more than 256 MiB" in answer.json()["error"]["message"]
    assert api.post("/api/sql", json={"sql": "select 'b'::enum('a', 'b') as e"}).json()["rows"] == [{"e": "b"}]


def test_a_page_shows_no_result_that_no_browser_can_show(api: httpx.Client) -> None:
    sent = {"sql": "select repeat('x', 100000) as a from range(500)"}
    page = api.post("/sql", data=sent)
    assert page.status_code == 200
    assert len(page.content) < 1_000_000
    assert "more than 4 MiB" in page.text
