"""Hostile statements, made from DuckDB's own lists: its kinds of statements, its functions, and what can hold them.

PLACE stands for a file of the store, OUT for one that is not there yet.
"""

from collections.abc import Iterator

import duckdb

READING = {"SELECT", "EXPLAIN"}
# kinds that no text has, or only text that DuckDB's parser makes into others
WITHOUT_TEXT = {
    "INVALID", "RELATION", "LOGICAL_PLAN", "EXTENSION", "CREATE_FUNC", "ANALYZE", "VARIABLE_SET", "COPY_DATABASE",
}  # fmt: skip
BY_KIND = {
    "INSERT": [
        "insert into internal.lake_channels select * from internal.lake_channels", "insert into samples values (1)",
    ],
    "UPDATE": ["update internal.lake_channels set unit = 'X'"],
    "CREATE": [
        "create table t as select 1", "create temp table t (a int)", "create or replace view samples as select 1",
        "create macro deg_per_h(a, b) as 0", "create schema s", "create sequence s", "create type k as enum ('a')",
        "create secret (type s3)", "create index i on internal.lake_channels (unit)",
    ],
    "DELETE": ["delete from internal.lake_channels", "truncate internal.lake_channels"],
    "PREPARE": ["prepare p as copy (select 42) to 'PLACE'"],
    "EXECUTE": ["execute p", "deallocate p"],
    "ALTER": ["alter table internal.lake_channels drop column unit", "alter view samples rename to s"],
    "TRANSACTION": ["begin", "begin transaction", "commit", "rollback", "abort"],
    "COPY": [
        "copy (select 42) to 'PLACE'", "copy (select 42) to 'OUT' (format parquet)",
        "copy internal.lake_channels from 'PLACE'",
        "copy (select 42) to 'OUT' (format csv, per_thread_output)", "copy samples to '/dev/stdout'",
    ],
    "DROP": ["drop view samples", "drop table internal.lake_channels", "drop macro adev", "drop schema main cascade"],
    "EXPORT": ["export database 'OUT'"],
    "PRAGMA": [
        "copy from database memory to memory", "pragma database_size", "pragma enable_profiling",
        "pragma force_checkpoint", "import database 'OUT'",
        "pragma profiling_output = 'PLACE'", "pragma temp_directory = 'OUT'",
    ],
    "VACUUM": ["vacuum", "vacuum analyze", "analyze", "analyze internal.lake_channels"],
    "CALL": [
        "call enable_logging(storage = 'file', storage_path = 'OUT')", "call pragma_version()", "call range(3)",
        "call enable_profiling(save_location = 'PLACE')", "call force_checkpoint()", "checkpoint",
        "force checkpoint",
    ],
    "LOAD": ["load httpfs", "install httpfs", "install './x.duckdb_extension'", "update extensions"],
    "ATTACH": ["attach 'OUT' as d", "attach 'PLACE' as d (read_only)", "attach ':memory:' as d", "use memory"],
    "DETACH": ["detach memory"],
    "MULTI": ["pivot samples on unit using avg(value)"],
    "MERGE_INTO": ["merge into internal.lake_channels c using (select 1 as a) s on true when matched then delete"],
    "SET": [
        "set variable a = 1", "set enable_external_access = true", "set allowed_directories = ['/']",
        "set lock_configuration = false",
        "set memory_limit = '1TB'", "set global threads = 64", "reset memory_limit", "set temp_directory = 'OUT'",
        "set log_query_path = 'OUT'", "set autoinstall_known_extensions = true",
    ],
}  # fmt: skip
WITHIN = [
    "with x as (delete from internal.lake_channels returning *) select * from x",
    "with x as materialized (insert into internal.lake_channels from internal.lake_channels returning *) from x",
    "with x as (update internal.lake_channels set unit = 'X' returning *) select count(*) from x",
    "with x as (copy (select 42) to 'PLACE') from x",
    "with a as (with x as (copy (select 42) to 'PLACE') from x) select * from a",
    "select (with x as (delete from internal.lake_channels returning 1) select count(*) from x)",
    "with recursive x as (copy samples to 'OUT') from x",
    "select 1; copy (select 42) to 'PLACE'",
    "select 1 /* ; */ ; drop view samples; --",
]
HOLDING = [
    "explain {}", "explain analyze {}", "EXPLAIN (ANALYZE, FORMAT JSON) {}", "/* a */ explain /* b */ analyze -- c\n{}",
    "explain (format html) {}", "{};", "  \n\t{}",
]  # fmt: skip
FILES = [
    "from 'PLACE'", "select * from \"PLACE\"", "from 'OUT'", "describe 'PLACE'", "summarize 'PLACE'",
    "from '/etc/passwd'",
    "from '*.parquet'", "select * from samples where unit in (select content from read_text('/etc/passwd'))",
    "select (select count(*) from glob('/etc/*'))", "with x as (from read_blob('PLACE')) from x",
    "from samples s, lateral (from read_text(s.unit))", "from query('copy (select 42) to ''PLACE''')",
    "from query('explain analyze delete from internal.lake_channels')", "from query_table('PLACE')",
    "from query_table(['samples', 'PLACE'])", "from 'https://example.org/x.parquet'", "from 's3://bucket/x.parquet'",
    "from json_execute_serialized_sql(json_serialize_sql('select 1'))", "from memory.main.\"PLACE\"",
    "select * from (describe 'PLACE')", "from READ_CSV_AUTO('/etc/passwd')",
    "from system.main.read_text('/etc/passwd')",
    "from (from (from read_parquet('PLACE')))", "select exists (from read_json('PLACE'))",
]  # fmt: skip
ENDLESS = [
    "select range(500000000)",
    "select list(i) from range(1000000000) t(i)",
    "select count(*) from range(100000000000) a, range(1000) b",
    "select length(repeat('x', 2000000000)) + length(repeat('y', 2000000000))",
    "with recursive r as (select 1 as x union all select x + 1 from r) select max(x) from r",
    "select * from range(10000000000)",
]
HARMLESS_EFFECTS = {
    "current_connection_id", "current_query", "current_query_id", "current_transaction_id", "error", "gen_random_uuid",
    "random", "stats", "uuid", "uuidv4", "uuidv7", "vector_type",
}  # fmt: skip
"""Functions that DuckDB says have side effects, and that change nothing but what they give."""


def statements(place: str, out: str) -> list[str]:
    """The corpus, without what is merely too large.

    Parameters
    ----------
    place, out : str
        A file of the store, and one that is not there yet.
    """
    plain = [each for kind in BY_KIND.values() for each in kind]
    held = [holder.format(each) for holder in HOLDING for each in [*plain, *WITHIN[:-2], *FILES]]
    every = [*plain, *WITHIN, *FILES, *held, *function_calls()]
    return [each.replace("PLACE", place).replace("OUT", out) for each in every]


def oversized() -> list[str]:
    """Statements that are large or deep themselves, or whose results are."""
    numbers = range(3000)
    return [
        "from range(100000000000)",
        "select i, repeat('x', 1000) from range(100000000) t(i)",
        "select * from samples a, samples b, samples c",
        "select " + ", ".join(f"{i} as c{i}" for i in numbers),
        "select " + "(" * 3000 + "1" + ")" * 3000,
        "explain select " + "(" * 3000 + "1" + ")" * 3000,
        "select " + "1 + " * 20_000 + "1",
        "select " + "not " * 5000 + "true",
        "select " + "[" * 2000 + "1" + "]" * 2000,
        "select " + "case when 1 = 1 then " * 900 + "1" + " else 0 end" * 900,
        "from " + "(from " * 900 + "range(3)" + ")" * 900,
        "select * from samples where unit in (" + ", ".join(f"'{i}'" for i in range(20_000)) + ")",
        "with " + ", ".join(f"c{i} as (select 1)" for i in numbers) + " select 1",
        "select 1" + " union all select 1" * 3000,
        "select * from " + ", ".join(f"range(2) t{i}" for i in range(60)),
        "select '" + "x" * 200_000 + "'",
    ]


def function_calls() -> Iterator[str]:
    """A call of each table function that is not known to read the catalogue only, and of scalars with effects."""
    from storage.sql.sandbox.guard import TABLE_FUNCTIONS

    rows = duckdb.connect().execute(
        "select distinct function_name, function_type, parameter_types, has_side_effects from duckdb_functions() "
        "where function_type in ('table', 'table_macro') or has_side_effects order by all"
    )
    for name, kind, types, has_effects in rows.fetchall():
        values = ", ".join(_value(each) for each in types if each is not None)
        if kind in {"table", "table_macro"} and name not in TABLE_FUNCTIONS:
            yield f"from {name}({values})"
            yield f"select * from samples where value in (select 1 from {name}({values}))"
        elif kind == "scalar" and has_effects and name not in HARMLESS_EFFECTS:
            yield f"select {name}({values})"


def _value(kind: str) -> str:
    if kind.endswith("[]"):
        return f"[{_value(kind[:-2])}]"
    return {"VARCHAR": "'PLACE'", "POINTER": "1", "TABLE": "(select 1)"}.get(kind, "1")
