"""Processes that do without pandas: pyarrow imports it where it is installed, which takes as long as all the rest."""

import inspect
import sys

# where pyarrow imports it, the innermost frame is that of who called pyarrow: its own frames are not seen
_WITHOUT = frozenset({"stream", "storage", "ingest", "analytics", "pyarrow"})


class _NoPandas:
    """A finder; the base class of finders takes longer to import than all of them."""

    def find_spec(self, fullname: str, *_: object) -> None:
        if fullname == "pandas" and _importer().partition(".")[0] in _WITHOUT:
            raise ModuleNotFoundError(name=fullname)


def _importer() -> str:
    """The module that imports."""
    frame = inspect.currentframe()
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if name != __name__ and name.partition(".")[0] != "importlib":
            return name
        frame = frame.f_back
    return ""


def hide_pandas() -> None:
    """Let neither this project nor pyarrow import pandas in this process; a metric of one's own may."""
    if not any(isinstance(each, _NoPandas) for each in sys.meta_path):
        sys.meta_path.insert(0, _NoPandas())
