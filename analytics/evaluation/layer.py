"""The tables that metrics add to a store's catalogue."""

import tomllib
from importlib.resources import files
from typing import TYPE_CHECKING

from analytics.step_records import FOLDER

if TYPE_CHECKING:
    from storage.findings import Finding
    from storage.sql.catalog import Catalog
    from storage.sql.tables import ColumnTexts
    from storage.store import Store


class MetricsLayer:
    """Step records and metrics, computed when a statement first names one of the tables, and kept in the store.

    The code that computes them is imported only then: every command that opens a catalogue makes a layer.
    """

    tables: tuple[str, ...] = (
        "step_means", "rate_steps", "static_steps", "unit_metrics", "bias_by_day", "temperature_curve", "unit_runs",
        "metric_names", "specification_limits", "specification_history", "unit_warnings", "unused_steps",
    )  # fmt: skip
    folder = FOLDER

    @property
    def examples(self) -> dict[str, str]:
        """Questions that its tables answer."""
        text = files("analytics.evaluation").joinpath("tables", "examples.toml").read_text(encoding="utf-8")
        return dict(tomllib.loads(text)[type(self).__name__])

    @property
    def columns(self) -> "ColumnTexts":
        """Descriptions of the columns of its tables."""
        from storage.sql.tables import read_texts

        return read_texts(files("analytics.evaluation").joinpath("tables", "columns.toml"))

    def fill(self, catalog: "Catalog") -> None:
        """Bring the metrics up to date, and define the tables."""
        from analytics.evaluation.kept_metrics import unit_metrics

        unit_metrics(catalog, catalog.progress)
        define_metric_tables(catalog)

    def findings(self, store: "Store") -> "list[Finding]":
        """Findings on the metrics that the store keeps."""
        from analytics.evaluation.kept_check import kept_findings

        return kept_findings(store)


class VerdictsLayer(MetricsLayer):
    """Verdicts on the metrics; apart from them, since their views take longer to define than all others."""

    tables = ("verdicts", "unit_verdicts", "yield_by", "failure_pareto", "conformity_risks")

    def fill(self, catalog: "Catalog") -> None:
        """Define the tables, after the metrics."""
        from analytics.evaluation.evaluation import define_scripts

        catalog.rows("from unit_metrics limit 0")  # fills the layer of metrics
        define_scripts(catalog, "verdict_tables")

    def findings(self, _store: "Store") -> "list[Finding]":
        """None: what the store keeps is of the metrics."""
        return []


def define_metric_tables(catalog: "Catalog") -> None:
    """Define the tables that use the step records and metrics of a catalogue, and the specifications of its store."""
    from analytics.evaluation.evaluation import define_scripts
    from analytics.specifications.sql_tables import put_names

    put_names(catalog)
    define_scripts(catalog, "tables")
