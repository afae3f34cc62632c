"""Processes that do without pandas: pyarrow imports it where it is installed, which takes as long as all the rest."""

import sys
from importlib.abc import MetaPathFinder


class _NoPandas(MetaPathFinder):
    def find_spec(self, fullname: str, *_: object) -> None:
        if fullname == "pandas":
            raise ModuleNotFoundError(name=fullname)


def hide_pandas() -> None:
    """Let nothing import pandas in this process; what has it already keeps it."""
    sys.meta_path.insert(0, _NoPandas())
