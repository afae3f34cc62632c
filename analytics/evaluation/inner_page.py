"""The inner page of a standard's certificate: JJF 2014-2022 annex A (24 rows), JJF 1536-2015 annex C (12 rows)."""

import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

from analytics.evaluation.selection import Row, Selection, selected
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog


class Words(NamedTuple):
    """A text in both languages."""

    en: str
    zh: str


class InnerRow(NamedTuple):
    """One characteristic of a unit: the values of the last run with any, or the reason why there is none."""

    number: int
    zh: str  # the name as it is printed there
    en: str
    metric: str  # the metric that fills the row
    standard: str
    results: tuple[Row, ...]
    reason: str | None

    @property
    def clause(self) -> str:
        """Clause of the standard."""
        sources = metrics()[self.metric].header.sources
        return "; ".join(each.clause for each in sources if each.standard == self.standard)


@lru_cache(maxsize=1)
def _pages() -> dict[str, list[dict[str, Any]]]:
    return tomllib.loads(files("analytics.evaluation").joinpath("inner_pages.toml").read_text(encoding="utf-8"))


def inner_page_titles(standard: str) -> list[Words]:
    """The names of a standard's rows, as they are printed, in both languages."""
    return [Words(entry["en"], entry["zh"]) for entry in _pages()[standard]]


def inner_page(catalog: Catalog, unit: str, standard: str) -> list[InnerRow]:
    """The rows of a unit in the order of the standard's page, always all of them."""
    rows = selected(catalog, Selection(units=(unit,), standards=(standard,)))
    began = dict(catalog.rows("select run, t_start_ns from unit_runs where unit = $unit", {"unit": unit}))
    of_metric: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_metric[row["metric"]].append(row)
    found = []
    for number, entry in enumerate(_pages()[standard], 1):
        metric = entry["metric"]
        mine = [row for row in of_metric[metric] if _is_meant(row, entry.get("only", {}))]
        found.append(InnerRow(number, entry["zh"], entry["en"], metric, standard, *_results(metric, mine, began)))
    return found


def _is_meant(row: Row, only: Mapping[str, str]) -> bool:
    """Whether a value belongs to a row of some parameters; an axis may be named by the signal alone, as ``rate_x``."""
    given = {"axis": (row["signal"] or "").rpartition("_")[2].upper()}
    given |= {name: each for name, each in row["parameters"].items() if each is not None}
    return all(given.get(name) == each for name, each in only.items())


def _results(metric: str, rows: Sequence[Row], began: Mapping[str, int]) -> tuple[tuple[Row, ...], str | None]:
    if not rows:
        return (), f"no completed step gives it: it needs {metrics()[metric].header.needs}"

    def when(row: Row) -> int:
        return max((began.get(run, 0) for run in row["runs"] or [row["run"]]), default=0)

    results: list[Row] = []
    for signal in sorted({row["signal"] or "" for row in rows}):
        valued = [row for row in rows if (row["signal"] or "") == signal and row["value"] is not None]
        # clause 6.1 asks for (20 +- 5) degC: other temperatures are shown only where there is nothing else
        valued = [row for row in valued if row["parameters"].get("room") is not False] or valued
        last = max((when(row) for row in valued), default=0)
        results += [row for row in valued if when(row) == last]
    return tuple(results), None if results else max(rows, key=when)["reason"]
