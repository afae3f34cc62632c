"""How samples are kept: the event log (MCAP), the lake (Parquet) and SQL over it."""

from os import PathLike
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from storage.opened import OpenedStore
    from storage.sql_door import QueryLimits


def open_store(folder: "str | PathLike[str]", limits: "QueryLimits | None" = None) -> "OpenedStore":
    """Open a store to ask it in SQL from Python; see `storage.opened.OpenedStore`.

    Raises
    ------
    StoreError
        If the folder is no store.
    """
    from storage.opened import OpenedStore

    return OpenedStore(folder, limits)
