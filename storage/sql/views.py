"""The views of a store, over the tables of the schema `internal` that their statements name."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.resources import files

import duckdb

from storage.sql.deferred import DeferredDefinitions, defined_names
from storage.sql.sandbox.guard import plain_message
from storage.store import Store
from stream.errors import QueryError, StoreError, UnknownUnit
from stream.quantities import conversion, is_angular_rate

VIEWS = (
    "samples", "signals", "runs", "units", "steps", "estimates", "events", "rollup_1s", "rollup_10s", "clocks",
    "exclusions",
)  # fmt: skip

_LISTING = re.compile(r"show|describe|information_schema|(duckdb|pragma|sqlite)_\w+|pg_(?!timezone_names)\w+")
_CONVERSIONS = ("deg_per_h", "deg_c")
_ALWAYS_CONVERTED = ("deg/s", "deg/h", "rad/s", "degC", "K", "degF")


@cache
def view_scripts() -> tuple[str, ...]:
    """The scripts of the views and macros, each of which stands on those before it."""
    scripts = sorted(files("storage.sql").joinpath("schema").iterdir(), key=lambda each: each.name)
    return tuple(script.read_text() for script in scripts if script.name.endswith(".sql"))


def define_views(connection: duckdb.DuckDBPyConnection) -> None:
    """Define the views and macros in the current database, which has the tables of parts in its schema `internal`."""
    for script in view_scripts():
        connection.execute(script)
    connection.execute(_stored_conversions(connection))


def defer_views(deferred: DeferredDefinitions, cursor_of: Callable[[], duckdb.DuckDBPyConnection]) -> None:
    """Let the same views and macros wait for a statement that names them; `cursor_of` gives one of their database."""

    def conversions() -> str:
        try:
            with cursor_of() as cursor:
                return _stored_conversions(cursor)
        except duckdb.Error as error:  # also where the catalogue closes meanwhile
            raise QueryError(plain_message(error)) from error

    for script in view_scripts():
        deferred.add(script)
    for name in _CONVERSIONS:
        deferred.add_macro(name, {"lake_channels"}, conversions)


def define_deferred_views(deferred: DeferredDefinitions) -> None:
    """Define those of them that wait."""
    deferred.define([*defined_names(view_scripts()), *_CONVERSIONS])


def lists_views(words: Iterable[str]) -> bool:
    """Whether a statement with these words may list the tables that there are."""
    return any(_LISTING.fullmatch(word) is not None for word in words)


def _stored_conversions(connection: duckdb.DuckDBPyConnection) -> str:
    """The statements of `conversion_macros` for the units of measure of all channels."""
    units = connection.execute("select distinct unit_of_measure from internal.lake_channels").fetchall()
    return conversion_macros(unit for (unit,) in units)


@contextmanager
def reading_lake(store: Store) -> Iterator[None]:
    """Within it an error of DuckDB is damage of the lake."""
    try:
        yield
    except duckdb.Error as error:
        raise unreadable_lake(store, error) from error


def unreadable_lake(store: Store, error: Exception) -> StoreError:
    """What says that the lake of a store is damaged, and the remedy."""
    return StoreError(
        f"the lake of {store.folder} cannot be read ({plain_message(error)}); `gyrofleet verify` lists the damage, "
        f"`gyrofleet recover` rebuilds it from the log"
    )


def conversion_macros(units: Iterable[str]) -> str:
    """Statements that define ``deg_per_h(value, unit_of_measure)`` and ``deg_c(value, unit_of_measure)``.

    Both give null for units of other quantities.

    >>> "when 'rpm' then value * '21600.0'::double + '0.0'::double" in conversion_macros(["rpm"])
    True
    """
    cases: dict[str, list[str]] = {"deg/h": [], "degC": []}
    for unit in sorted({*units, *_ALWAYS_CONVERTED}):
        with suppress(UnknownUnit):
            target = "deg/h" if is_angular_rate(unit) else "degC"
            factor, offset = conversion(unit, target)
            quoted = unit.replace("'", "''")
            # plain literals would be decimals, whose products overflow
            cases[target].append(f"when '{quoted}' then value * '{factor!r}'::double + '{offset!r}'::double")
    return "".join(
        f"create or replace macro {name}(value, unit_of_measure) as case unit_of_measure {' '.join(cases[target])} end;"
        for name, target in (("deg_per_h", "deg/h"), ("deg_c", "degC"))
    )
