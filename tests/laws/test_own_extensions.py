"""An extension with a mistake is named, and claims nothing."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation import evaluation
from analytics.loop.effects import registry
from analytics.loop.effects.monomial import channel_linear
from analytics.metric_registry.registry import BoundsSource, metrics
from storage.sql.catalog import NotKept
from stream.errors import BadInput, QueryError


@pytest.mark.parametrize(("lo", "hi"), [(2.9, 3.1), (7.0, 5.0), (6.1, None), (None, 5.9)])
def test_an_interval_that_does_not_contain_the_value_is_a_mistake(lo: float | None, hi: float | None) -> None:
    columns = {name: pa.array([None, None], pa.float64()) for name in ("standard_uncertainty", "freedom")} | {
        "value": pa.array([6.0, 6.0]), "lo": pa.array([lo, 5.0], pa.float64()), "hi": pa.array([hi, 7.0], pa.float64()),
        "reason": pa.array([None, None], pa.string()),
    }  # fmt: skip
    evaluation._add_bounds(columns, BoundsSource.GIVEN)
    assert columns["value"].to_pylist() == [None, 6.0]
    assert columns["lo"].to_pylist() == [None, 5.0]
    wrong, right = columns["reason"].to_pylist()
    assert (right, "does not contain the value" in wrong) == (None, True)


def test_a_metric_that_fails_is_named_and_what_is_no_mistake_of_it_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(error: Exception) -> Any:
        def compute(*_: object) -> pa.Table:
            raise error

        return compute

    for own in (IndexError("index 9"), QueryError("Parser Error: near ( (views: samples)")):
        monkeypatch.setattr(evaluation, "_computed", failing(own))
        with pytest.raises(QueryError, match=r"metric bias cannot be computed: .*analytics/metrics/bias.sql") as found:
            evaluation._found(SimpleNamespace(), metrics()["bias"])  # type: ignore[arg-type]
        assert "views" not in str(found.value)
    for other in (NotKept(), MemoryError(), BadInput("of the store")):
        monkeypatch.setattr(evaluation, "_computed", failing(other))
        with pytest.raises(type(other)):
            evaluation._found(SimpleNamespace(), metrics()["bias"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("metric", "without", "more", "word"),
    [("bias", set(), {"raeson"}, "'raeson'"), ("scale_factor_asymmetry", {"hi"}, set(), "no column hi")],
)
def test_a_column_that_nothing_reads_or_that_is_missing_is_named(
    metric: str, without: set[str], more: set[str], word: str
) -> None:
    names = {*evaluation.COLUMNS.names, *more} - without
    with pytest.raises(QueryError, match=word):
        evaluation._check_columns(metrics()[metric], names)
    evaluation._check_columns(metrics()[metric], evaluation.COLUMNS.names)


def test_two_effects_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_effects_in", lambda _: [channel_linear("pressure")])
    with pytest.raises(BadInput, match="give one of them another name"):
        registry.effects.__wrapped__()  # not the kept ones


def test_an_own_effect_takes_the_place_of_the_general_one_of_its_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    own = channel_linear("pressure")
    own.name = "ambient_pressure"
    known = {**registry.effects(), own.name: own}
    runs: Any = [SimpleNamespace(channels=dict.fromkeys(("pressure", "compressor"), np.zeros(1)))]
    assert {"channel:pressure", "channel:compressor"} <= registry._candidates(runs).keys()
    monkeypatch.setattr(registry, "effects", lambda: known)
    found = registry._candidates(runs)
    assert "ambient_pressure" in found
    assert "channel:compressor" in found
    assert "channel:pressure" not in found
