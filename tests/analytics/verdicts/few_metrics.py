"""Catalogues that compute a few metrics, in this process and in commands that are forked."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from analytics.evaluation import budgets, kept_metrics, selection
from tests.forked_commands import COMMAND_METRICS

UNPATCHED = (budgets, selection)  # imported before: else they would keep the patched function


@contextmanager
def computing(*wanted: str) -> Iterator[None]:
    """Catalogues compute these metrics alone, a tenth of the time; all are computed by the long tests."""
    compute = kept_metrics.unit_metrics
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kept_metrics, "unit_metrics", lambda catalog, progress: compute(catalog, progress, wanted))
        patch.setenv(COMMAND_METRICS, " ".join(wanted))
        yield
