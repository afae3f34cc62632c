"""Moments with an offset in statements and parameters are compared as the instants that they name."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import duckdb
import pytest

from storage.sql.sandbox.moments import in_utc
from stream.errors import QueryError

AT = "2026-11-20T08:00:10.000000001+08:00"  # one nanosecond after the time of the row


@pytest.fixture(scope="module")
def connection() -> Iterator[duckdb.DuckDBPyConnection]:
    with duckdb.connect() as connection:
        connection.execute("set timezone = 'UTC'")
        connection.execute(
            "create table s as select timestamp_ns '2026-11-20 00:00:10' as time, "
            "timestamp '2026-11-20 00:00:10' as us, timestamptz '2026-11-20 00:00:10Z' as zoned, "
            "'2026-11-20T08:00:10+08:00' as word"
        )
        yield connection


def asked(connection: duckdb.DuckDBPyConnection, sql: str, parameters: object = None) -> Any:
    ((found,),) = connection.execute(*in_utc(connection, sql, parameters)).fetchall()
    return found


@pytest.mark.parametrize(
    "text",
    [
        "2026-11-20T08:00:10+08:00", "2026-11-20 08:00:10.0+08", "2026-11-20 08:00:10 +0800", "2026-11-20T00:00:10Z",
        "2026-11-19 18:00:10-06:00", "2026-11-20 05:30:10+05:30", "2026-11-20 08:00:10 Asia/Shanghai",
        "2026-11-20 00:00:10", " 2026/11/20 08:00:10+08 ",
    ],
)  # fmt: skip
def test_a_literal_is_the_instant_that_it_names(connection: duckdb.DuckDBPyConnection, text: str) -> None:
    for column in ("time", "us", "zoned"):
        if column != "zoned" or " +" not in text:  # which DuckDB does not read as a moment with a zone
            assert asked(connection, f"select {column} = '{text}' from s"), column
    assert asked(connection, "select time = $p from s", {"p": text})
    assert asked(connection, "select time = ? from s", [text])


@pytest.mark.parametrize(
    "condition",
    [
        "time < X", "X > time", "time between X and X is false", "time not in ('2027-01-01', X)",
        "time is distinct from X", "greatest(time, X) > time", "coalesce(null, time, X) < X", "nullif(time, X) = time",
        "time in (X) is false",
        "timestamp_ns X > time", "X::timestamp_ns > time", "cast(X as timestamp) = us", "try_cast(X as timestamp) = us",
        "date_diff('second', us, X) = 0", "case when true then X else time end > time", "X::date = date '2026-11-20'",
        "([X]::timestamp_ns[])[1] > time", "word = '2026-11-20T08:00:10+08:00' and 'é' <> word and X > time",
        "lag(time, 1, X) over () > time", "(select max(time) from s where time > X) is null",
    ],
)  # fmt: skip
def test_wherever_a_text_is_taken_for_a_time(connection: duckdb.DuckDBPyConnection, condition: str) -> None:
    for literal in (f"'{AT}'", f"$${AT}$$"):
        assert asked(connection, f"select {condition.replace('X', literal)} from s")
    if "timestamp_ns X" not in condition:
        assert asked(connection, f"select {condition.replace('X', '$p')} from s", {"p": AT})


@pytest.mark.parametrize(
    "expression",
    [
        "X",
        "word = X",
        "word in (X, 'a')",
        "X = X",
        "concat(X, time)",
        "{'a': X}",
        "arg_max(X, time)",
        "X || ' ' || time",
    ],
)
def test_a_text_among_texts_is_not_touched(connection: duckdb.DuckDBPyConnection, expression: str) -> None:
    sql = f"select {expression} from s".replace("X", f"'{AT}'")
    assert in_utc(connection, sql, None) == (sql, None)
    named = f"select {expression} from s".replace("X", "$p")
    assert in_utc(connection, named, {"p": AT}) == (named, {"p": AT})


def test_a_parameter_may_be_a_time_here_and_a_text_there(connection: duckdb.DuckDBPyConnection) -> None:
    sql = "select time = $p and word = $p from s"
    assert asked(connection, sql, {"p": "2026-11-20T08:00:10+08:00"})


def test_a_datetime_with_a_zone_is_its_instant(connection: duckdb.DuckDBPyConnection) -> None:
    for moment in (datetime(2026, 11, 20, 0, 0, 10, tzinfo=UTC), datetime(2026, 11, 20, 0, 0, 10)):
        for column in ("time", "us", "zoned"):
            assert asked(connection, f"select {column} = $p from s", {"p": moment})
    at = datetime(2026, 11, 20, 8, 0, 10, tzinfo=timezone(timedelta(hours=8)))
    assert asked(connection, "select time = $p from s", {"p": at})
    assert asked(connection, "select us = any($p) from s", {"p": [at]})
    with pytest.raises(QueryError, match="no date in UTC"):
        in_utc(connection, "select $p", {"p": datetime.min.replace(tzinfo=at.tzinfo)})


def test_a_zone_that_nobody_knows_is_refused(connection: duckdb.DuckDBPyConnection) -> None:
    """DuckDB takes any word behind a moment for a zone, and drops it."""
    with pytest.raises(QueryError, match="write its offset"):
        asked(connection, "select time = '2026-11-20 08:00:10 PM' from s")
    assert asked(connection, "select word <> '2026-11-20 08:00:10 PM' from s")


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("(timestamp 'X')::varchar", "2026-11-20 00:00:10"), ("(timestamp 'X')::time::varchar", "00:00:10"),
        ("cast(timestamp 'X' as timestamp_ns)::varchar", "2026-11-20 00:00:10"),
        ("'X'::varchar::timestamp::varchar", "2026-11-20 00:00:10"),
        ("timestamptz 'X' = '2026-11-20 00:00:10Z'::timestamptz", True), ("'X'::timestamptz::timestamp::varchar",
        "2026-11-20 00:00:10"),
    ],
)  # fmt: skip
def test_a_cast_of_a_cast_is_that_of_the_instant(
    connection: duckdb.DuckDBPyConnection, expression: str, expected: object
) -> None:
    assert asked(connection, f"select {expression.replace('X', '2026-11-20T08:00:10+08:00')}") == expected


@pytest.mark.parametrize(
    ("statement", "parameters"),
    [
        ("select count(*) from s a asof join s b on a.word = b.word and a.time >= b.time where a.time = 'X'", None),
        ("select {'a': time} = {'a': 'X'} from s where time = 'X'", None), ("select ['X']::timestamp[1]", None),
        ("select {'t': 'X'}::struct(t timestamp)", None), ("select map(['a'], ['X'])::map(varchar, timestamp)", None),
        ("select lag(time, $n, us) over () from s where time = $t", {"n": 1, "t": "X"}),
        ("select time = any($l::timestamp_ns[]) from s", {"l": ["X"]}),
        ("select time >= $l[1]::timestamp from s", {"l": ["X"]}),
    ],
)  # fmt: skip
def test_what_may_be_a_time_and_cannot_be_told_is_refused(
    connection: duckdb.DuckDBPyConnection, statement: str, parameters: dict[str, Any] | None
) -> None:
    """Each of them dropped the offset in silence."""
    at = "2026-11-20T08:00:10+08:00"
    given = parameters and {name: at if each == "X" else [at] if each == ["X"] else each
                            for name, each in parameters.items()}  # fmt: skip
    with pytest.raises(QueryError, match="offset"):
        in_utc(connection, statement.replace("X", at), given)


def test_members_of_a_list_are_asked_about_at_once(connection: duckdb.DuckDBPyConnection) -> None:
    moments = ", ".join(f"'2026-11-20T08:00:{second:02}+08:00'" for second in range(60))
    statement, _ = in_utc(connection, f"select time in ({moments}) from s", None)
    assert statement.count("+00'") == 60
    assert "+08:00" not in statement
