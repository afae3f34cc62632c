"""The views of a store, over the tables of the schema `internal` that their statements name."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.resources import files

import duckdb

from storage.sql.sandbox.guard import plain_message
from storage.store import Store
from stream.errors import StoreError, UnknownUnit
from stream.quantities import conversion, is_angular_rate

VIEWS = ("samples", "signals", "runs", "units", "steps", "estimates", "events", "rollup_1s", "rollup_10s", "clocks")

_ALWAYS_CONVERTED = ("deg/s", "deg/h", "rad/s", "degC", "K", "degF")


def define_views(connection: duckdb.DuckDBPyConnection) -> None:
    """Define the views and macros in the current database, which has the tables of parts in its schema `internal`."""
    for script in sorted(files("storage.sql").joinpath("schema").iterdir(), key=lambda each: each.name):
        if script.name.endswith(".sql"):
            connection.execute(script.read_text())
    units = connection.execute("select distinct unit_of_measure from internal.lake_channels").fetchall()
    connection.execute(conversion_macros(unit for (unit,) in units))


@contextmanager
def reading_lake(store: Store) -> Iterator[None]:
    """Within it an error of DuckDB is damage of the lake."""
    try:
        yield
    except duckdb.Error as error:
        raise StoreError(
            f"the lake of {store.folder} cannot be read ({plain_message(error)}); `gyrofleet verify` lists the damage, "
            f"`gyrofleet recover` rebuilds it from the log"
        ) from error


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
