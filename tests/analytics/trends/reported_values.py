"""Values of metrics in a store."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from storage.sql.catalog import Catalog

HOUR_NS = 3600 * 10**9
START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00 UTC
Reported = Callable[[Sequence[Mapping[str, Any]]], Catalog]
