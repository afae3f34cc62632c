"""The 24 rows of JJF 2014-2022 annex A (inner page of the certificate) for one unit."""

import tomllib
from collections import defaultdict
from importlib.resources import files
from typing import NamedTuple

from analytics.evaluation.selection import Row, Selection, selected
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog

STANDARD = "JJF2014"


class Characteristic(NamedTuple):
    """A row of the annex: its name as it is printed there, and the metric that fills it."""

    zh: str
    en: str
    metric: str


_ROWS = tomllib.loads(files("analytics.evaluation").joinpath("annex_a.toml").read_text(encoding="utf-8"))
_CHARACTERISTICS = tuple(Characteristic(zh, en, metric) for metric, (zh, en) in _ROWS.items())


class AnnexRow(NamedTuple):
    """One characteristic of a unit: the values of the last run with any, or the reason why there is none."""

    number: int
    characteristic: Characteristic
    results: tuple[Row, ...]
    reason: str | None

    @property
    def clause(self) -> str:
        """Clause of the standard."""
        sources = metrics()[self.characteristic.metric].header.sources
        return "; ".join(each.clause for each in sources if each.standard == STANDARD)

    def document(self) -> dict[str, object]:
        """The row as JSON."""
        names = self.characteristic._asdict()
        return {"number": self.number, **names, "results": self.results, "reason": self.reason}


def annex_a(catalog: Catalog, unit: str) -> list[AnnexRow]:
    """The annex of a unit: always 24 rows."""
    rows = selected(catalog, Selection(units=(unit,), standards=(STANDARD,)))
    began = dict(catalog.rows("select run, t_start_ns from unit_runs where unit = $unit", {"unit": unit}))
    of_metric: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_metric[row["metric"]].append(row)
    return [_row(number, each, of_metric[each.metric], began) for number, each in enumerate(_CHARACTERISTICS, 1)]


def _row(number: int, characteristic: Characteristic, rows: list[Row], began: dict[str, int]) -> AnnexRow:
    if not rows:
        needs = metrics()[characteristic.metric].header.needs
        return AnnexRow(number, characteristic, (), f"no completed step gives it: it needs {needs}")

    def when(row: Row) -> int:
        return max((began.get(run, 0) for run in row["runs"] or [row["run"]]), default=0)

    results: list[Row] = []
    for signal in sorted({row["signal"] or "" for row in rows}):
        valued = [row for row in rows if (row["signal"] or "") == signal and row["value"] is not None]
        # clause 6.1 asks for (20 +- 5) degC: other temperatures are shown only where there is nothing else
        valued = [row for row in valued if row["parameters"].get("room") is not False] or valued
        last = max((when(row) for row in valued), default=0)
        results += [row for row in valued if when(row) == last]
    if results:
        return AnnexRow(number, characteristic, tuple(results), None)
    return AnnexRow(number, characteristic, (), max(rows, key=when)["reason"])
