"""The 24 rows of JJF 2014-2022 annex A (inner page of the certificate) for one unit."""

import tomllib
from collections import defaultdict
from importlib.resources import files
from typing import NamedTuple

from analytics.evaluation.selection import Row, Selection, selected
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog

STANDARD = "JJF2014"


# by the metric that fills a row, its name in Chinese and English
_ROWS = tomllib.loads(files("analytics.evaluation").joinpath("annex_a.toml").read_text(encoding="utf-8"))


class AnnexRow(NamedTuple):
    """One characteristic of a unit: the values of the last run with any, or the reason why there is none."""

    number: int
    zh: str  # the name as it is printed there
    en: str
    metric: str  # the metric that fills the row
    results: tuple[Row, ...]
    reason: str | None

    @property
    def clause(self) -> str:
        """Clause of the standard."""
        sources = metrics()[self.metric].header.sources
        return "; ".join(each.clause for each in sources if each.standard == STANDARD)


def annex_a(catalog: Catalog, unit: str) -> list[AnnexRow]:
    """The annex of a unit: always 24 rows."""
    rows = selected(catalog, Selection(units=(unit,), standards=(STANDARD,)))
    began = dict(catalog.rows("select run, t_start_ns from unit_runs where unit = $unit", {"unit": unit}))
    of_metric: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_metric[row["metric"]].append(row)
    found = []
    for number, (metric, (zh, en)) in enumerate(_ROWS.items(), 1):
        found.append(AnnexRow(number, zh, en, metric, *_results(metric, of_metric[metric], began)))
    return found


def _results(metric: str, rows: list[Row], began: dict[str, int]) -> tuple[tuple[Row, ...], str | None]:
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
