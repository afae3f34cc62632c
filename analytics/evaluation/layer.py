"""The tables that metrics add to a store's catalogue."""

from importlib.resources import files
from typing import TYPE_CHECKING, ClassVar

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
    examples: ClassVar[dict[str, str]] = {
        "Every metric of a unit": "select metric, value, lo, hi, unit_of_measure, reason from unit_metrics "
        "where unit = 'FOG-0231'",
        "Bias by day": "select unit, day, position, temperature_command, bias from bias_by_day order by unit, day",
        "Bias against temperature": "select unit, temperature, bias, standard_uncertainty from temperature_curve "
        "order by unit, temperature",
        "The fleet's 100 s bias stability": "select unit, value from unit_metrics "
        "where metric = 'bias_stability_averaged' and (parameters->>'$.average_s')::double = 100 order by value desc",
    }

    @property
    def columns(self) -> "ColumnTexts":
        """Descriptions of the columns of its tables."""
        from storage.sql.tables import read_texts

        return read_texts(files("analytics.evaluation").joinpath("tables", "columns.toml"))

    def fill(self, catalog: "Catalog") -> None:
        """Bring the metrics up to date, and define the tables."""
        from analytics.evaluation.evaluation import unit_metrics

        unit_metrics(catalog, catalog.progress)
        define_metric_tables(catalog)

    def findings(self, store: "Store") -> "list[Finding]":
        """Findings on the metrics that the store keeps."""
        from analytics.evaluation.kept_check import kept_findings

        return kept_findings(store)


class VerdictsLayer(MetricsLayer):
    """Verdicts on the metrics; apart from them, since their views take longer to define than all others."""

    tables = ("verdicts", "unit_verdicts", "yield_by", "failure_pareto")
    examples: ClassVar[dict[str, str]] = {
        "Which units are not good, and why?": "select unit, metric, verdict, value, lower, upper, reason "
        "from verdicts where verdict <> 'PASS' order by unit, metric",
        "Yield of each lot": "select name as lot, units, passed, failed, yield, yield_lo, yield_hi from yield_by "
        "where kind = 'lot'",
        "What do units fail by?": "select metric, subject, failed, judged, cumulative_share from failure_pareto",
    }

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
