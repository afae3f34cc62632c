"""The inner page of a standard's certificate: its characteristics in their order, with the results of a unit."""

from analytics.certificate.standards import Standard
from analytics.evaluation.annex_a import AnnexRow, annex_a
from storage.sql.catalog import Catalog


def inner_page(catalog: Catalog, unit: str, standard: Standard) -> list[AnnexRow]:
    """The rows of the inner page of a unit."""
    assert standard.name == "JJF2014"
    return annex_a(catalog, unit)
