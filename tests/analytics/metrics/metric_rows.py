"""What tests ask of rows of metrics, and the constants of the records behind them."""

from typing import Any

import pytest

from tests.analytics.conftest import SECOND_NS

DAY_NS = 86_400 * SECOND_NS
EARTH_DEG_PER_H = 15.041067
DT_NS = SECOND_NS // 4
HOUR = 14_400  # samples
Rows = list[dict[str, Any]]


def exact(value: Any) -> Any:
    return pytest.approx(value, rel=1e-9)


def one(rows: Rows, **words: Any) -> dict[str, Any]:
    found = [row for row in rows if all(row.get(name) == value for name, value in words.items())]
    assert len(found) == 1, (words, rows)
    return found[0]
