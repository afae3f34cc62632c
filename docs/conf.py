"""Settings of the documentation's site: ``sphinx-build -W docs docs/_build/html``."""

import importlib.metadata
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parents[1]))
from docs.generate import write_reference

project = "gyrofleet"
release = importlib.metadata.version("gyrofleet")
html_theme = "furo"
html_title = "gyrofleet"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_numpy_docstring = True
suppress_warnings = ["misc.highlighting_failure"]

_PARAMETER = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*): (.*)$")


def _two_lines(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Write ``name: text`` of our docstrings as napoleon expects it, on two lines."""
    section = ""
    found: list[str] = []
    for at, line in enumerate(lines):
        if at + 1 < len(lines) and lines[at + 1].startswith("----"):
            section = line
        parameter = _PARAMETER.match(line) if section in ("Parameters", "Attributes", "Raises") else None
        found += [parameter[1], f"    {parameter[2]}"] if parameter else [line]
    lines[:] = found


def setup(app: Sphinx) -> None:
    """Write the generated pages before the others are read."""
    app.connect("autodoc-process-docstring", _two_lines, priority=400)
    app.connect("builder-inited", lambda app: write_reference(Path(app.srcdir) / "_generated"))
