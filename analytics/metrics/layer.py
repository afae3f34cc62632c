"""The tables that metrics add to a store's catalogue."""

from importlib.resources import files

from analytics.metrics.evaluation import unit_metrics
from analytics.step_records.step_table import FOLDER
from storage.catalog import Catalog


class MetricsLayer:
    """Step records and metrics; computed when a statement first names one of the tables, and kept in the store."""

    tables = ("step_means", "rate_steps", "static_steps", "unit_metrics", "bias_by_day", "temperature_curve")
    folder = FOLDER

    def fill(self, catalog: Catalog) -> None:
        """Bring the metrics up to date, and define the tables."""
        unit_metrics(catalog)
        folder = files("analytics.metrics").joinpath("tables")
        for script in sorted(folder.iterdir(), key=lambda each: each.name):
            if script.name.endswith(".sql"):
                catalog.define(script.read_text(encoding="utf-8"))
