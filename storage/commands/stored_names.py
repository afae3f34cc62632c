"""Option types that complete the names of a store: units, runs, signals."""

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from stream.errors import GyrofleetError
from stream.terminal.console import DEFAULT_STORE

_STATEMENTS = {
    "unit": "select distinct unit from signals where starts_with(unit, $1) order by 1 limit 500",
    "run": "select run from runs where starts_with(run, $1) order by started desc limit 500",
    "signal": "select distinct signal from signals where starts_with(signal, $1) order by 1 limit 500",
}


class StoredName(click.ParamType[str]):
    """Text that the shell completes from the store of the command line; `kind` is unit, run or signal."""

    name = "text"

    def __init__(self, kind: str) -> None:
        self._statement = _STATEMENTS[kind]

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Names in the store that begin with what is typed; none where there is no store."""
        from storage.sql.catalog import Catalog
        from storage.store import Store

        folder = Path(ctx.params.get("folder") or DEFAULT_STORE)
        try:
            with Catalog(Store.open(folder), frozen=True) as catalog:
                found = catalog.rows(self._statement, [incomplete])
        except GyrofleetError:
            return []
        return [CompletionItem(str(name)) for (name,) in found]


UNIT = StoredName("unit")
RUN = StoredName("run")
SIGNAL = StoredName("signal")
