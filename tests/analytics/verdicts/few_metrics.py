"""Catalogues that compute a few metrics."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from analytics.evaluation import budgets, kept_metrics, selection

UNPATCHED = (budgets, selection)  # imported before: else they would keep the patched function


@contextmanager
def computing(*wanted: str) -> Iterator[None]:
    """Catalogues compute these metrics alone, a tenth of the time; all are computed by the long tests."""
    compute = kept_metrics.unit_metrics
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kept_metrics, "unit_metrics", lambda catalog, progress: compute(catalog, progress, wanted))
        yield
