"""How samples are kept: the event log (MCAP), the lake (Parquet) and SQL over it."""

from os import PathLike
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from storage.sql.door import QueryLimits
    from storage.sql.opened import OpenedStore


def open_store(folder: "str | PathLike[str]", limits: "QueryLimits | None" = None) -> "OpenedStore":
    """Open a store to ask it in SQL from Python (`OpenedStore`); StoreError if the folder is no store."""
    from storage.sql.opened import OpenedStore

    return OpenedStore(folder, limits)
