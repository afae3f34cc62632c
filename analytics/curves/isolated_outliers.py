"""Isolated outliers of a stored signal."""

from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, read_signal
from stream.defects.outliers import IsolatedOutliers, count_outliers


def isolated_outliers(catalog: Catalog, record: SignalRecord) -> IsolatedOutliers:
    """Isolated outliers of a stored signal."""
    return count_outliers(batch.value_array for batch in read_signal(catalog, record))
